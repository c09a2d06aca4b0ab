#!/usr/bin/env bash
# Measures go1-parkour: its numbers and figures in docs/results.md and docs/memory.md, except those of
# a learned gate and of VB-Com's switch (benchmarks/NOTES.md, "Other switches, ground by ground").
# Takes about an hour on one core; parts of studies that are done are not run again.
set -euo pipefail
cd "$(dirname "$0")/.."
study() { # NAME COMMAND...: keeps results/NAME/summary.json, of robots in nominal conditions.
    renet evaluate "${@:2}" --conditions nominal --out "results/$1"
    cp "results/$1/summary.json" "benchmarks/results/shipped/$1.json"
}
figure() { cp "results/$1" "docs/figures/$2"; }

study success terrain --preset success --modes camera blind
study success_100 terrain --preset success --modes camera --levels 8 10 --robots 100
gaps="--kinds gap --robots 100 --modes camera switch blind memory"
study gap_dead terrain --preset success $gaps --levels 5 8 10 --fault unplugged
study gap_gaussian terrain --preset success $gaps --levels 8 --fault gaussian:5
study gap_blackout terrain --preset success $gaps --levels 8 --fault blackout:5
study dawn terrain --preset dawn
study terrain terrain --modes camera memory
study standing terrain --preset standing
study memory memory
study reach memory --preset reach --robots 30
grounds="gap:3 platform:6 stairs_up:6 stairs_down:10 obstacles:10"
study blackout memory --grounds $grounds --without 2 6
study blackout_on_the_way memory --grounds $grounds --without 2 6 --before 1.5
study gap_on_the_way memory --grounds gap:3 --without 6 --before 1.5 --robots 100 --modes memory camera --seed 2
study two_seconds memory --grounds $grounds --without 2 --robots 100 --modes memory
study noise faults --preset noise
study stairs faults --preset noise --grounds stairs_up --level 5 --onsets 1.5 --seconds 10
study healthy faults --faults gaussian:4 frozen:5 --grounds flat --onsets 0.5 --healthy-minutes 200
study grass faults --faults tall_grass --onsets 1.5 --healthy-minutes 0 --modes memory
study camera_use camera-use
study margins margins --quick --seconds 5
python benchmarks/filter.py --conditions nominal
cp results/filter/summary.json benchmarks/results/shipped/filter.json
python benchmarks/first_walk.py --json benchmarks/results/first_walk.json
before_the_edge="--severities 5 --onsets 1.5 --healthy-minutes 0"
study severity_5 faults $before_the_edge --modes camera memory blind
study severity_5_rules faults $before_the_edge --modes switch oracle
study unnoticed faults --faults saturated:3 saturated:4 glass:3 glass:4 near_field:3 near_field:4 edge_shadow:3 \
    edge_shadow:4 --onsets 1.5 --healthy-minutes 0 --modes camera memory
figure success/success.png success.png
figure memory/memory.png memory.png
figure reach/reach.png reach.png
figure noise/noise.png noise.png
figure margins/margins.png margins.png
figure filter/filter.png filter.png
figure severity_5/crossed.png crossed.png
python tools/tables.py --fill
