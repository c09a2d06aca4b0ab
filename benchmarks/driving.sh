#!/usr/bin/env bash
# Measures the policy on trial that can be driven: every number of docs/results.md, "Being driven".
# Takes a quarter of an hour on two cores; parts of studies that are done are not run again.
set -euo pipefail
cd "$(dirname "$0")/.."
study() { # NAME COMMAND...: keeps results/driving/NAME/summary.json.
    renet evaluate "${@:2}" --bundle results/go1-driven --out "results/driving/$1"
    cp "results/driving/$1/summary.json" "benchmarks/results/driving/$1.json"
}

if [ ! -d results/go1-driven ]; then
    renet export benchmarks/results/driving/checkpoint --out results/go1-driven
    renet calibrate results/go1-driven --conditions training
fi
study commands commands --modes camera blind
study commands_training commands --modes camera --conditions training
study success terrain --preset success --modes camera --levels 6 7 8 10
study success_go1 terrain --preset success --modes camera --levels 6 7 8 10 --motors go1 --conditions training
study stops terrain --preset stops --robots 20
study backing terrain --preset backing --modes memory blind
python benchmarks/lies.py results/go1-driven --json benchmarks/results/driving/lies.json
cp results/driving/commands/commands.png docs/figures/driven.png
python tools/tables.py --fill
