#!/usr/bin/env bash
# Measures the policy that ships: every number and figure of docs/pretrained.md and docs/memory.md.
# Takes three hours on one core; a study that is done is not run again (`renet evaluate` keeps its parts).
set -euo pipefail
cd "$(dirname "$0")/.."
study() { # NAME COMMAND...: keeps results/NAME/summary.json.
    renet evaluate "${@:2}" --out "results/$1"
    cp "results/$1/summary.json" "benchmarks/results/shipped/$1.json"
}
figure() { cp "results/$1" "docs/figures/$2"; }

study success terrain --preset success --modes vp op
study success_100 terrain --preset success --modes vp --levels 8 10 --robots 100
study terrain terrain --modes vp renet
study standing terrain --preset standing
study memory memory
study noise faults --preset noise
study stairs faults --preset noise --grounds stairs_up --level 5 --onsets 1.5 --seconds 10
study healthy faults --faults gaussian:4 frozen:5 --grounds flat --onsets 0.5 --healthy-minutes 200
study grass faults --faults tall_grass --onsets 1.5 --healthy-minutes 0 --modes renet
study margins margins --quick --seconds 5
python benchmarks/course.py && cp results/course/summary.json benchmarks/results/shipped/course.json
python benchmarks/filter.py && cp results/filter/summary.json benchmarks/results/shipped/filter.json
study severity_5 faults --severities 5 --onsets 1.5 --healthy-minutes 0 --modes vp renet op
figure success/success.png success.png
figure memory/memory.png memory.png
figure noise/noise.png noise.png
figure margins/margins.png margins.png
figure course/passages.png passages.png
figure filter/filter.png filter.png
figure severity_5/crossed.png crossed.png
