#!/usr/bin/env bash
# Measures the policies that can be driven, go1-driven and go2-driven: every number of docs/results.md, "Being driven"
# and "Go2, driven". Takes a quarter of an hour on two cores; parts of studies that are done are not run again.
set -euo pipefail
cd "$(dirname "$0")/.."
study_of() { # BUNDLE NAME COMMAND...: keeps results/driving/NAME/summary.json.
    renet evaluate "${@:3}" --bundle "$1" --out "results/driving/$2"
    cp "results/driving/$2/summary.json" "benchmarks/results/driving/$2.json"
}
study() { study_of go1-driven "$@"; }

study commands commands --modes camera blind --conditions nominal
study commands_training commands --modes camera --conditions training
crossing="terrain --preset success --modes camera --levels 6 7 8 10"
on_go1_motors="$crossing --motors go1 --conditions training"
study success $crossing --conditions nominal
study success_fast $crossing --conditions nominal --speed 1
study_of go1-parkour success_parkour $crossing --conditions nominal
study success_go1 $on_go1_motors
study_of go1-parkour success_go1_parkour $on_go1_motors
study gap_dead terrain --preset success --kinds gap --levels 6 7 8 --modes camera switch blind memory \
    --fault unplugged --conditions nominal
study stops terrain --preset stops --robots 20 --conditions nominal
study backing terrain --preset backing --modes memory blind --conditions nominal
study reach memory --preset reach --robots 30 --conditions nominal
python benchmarks/lies.py go1-driven --json benchmarks/results/driving/lies.json

study_of go2-driven go2_commands commands --modes camera blind --conditions nominal
study_of go2-driven go2_success $crossing --conditions nominal
study_of go2-driven go2_success_fast $crossing --conditions nominal --speed 1
study_of go2-parkour go2_success_parkour $crossing --conditions nominal
study_of go2-driven go2_gap_dead terrain --preset success --kinds gap --levels 6 7 8 --modes camera switch blind memory \
    --fault unplugged --conditions nominal
study_of go2-driven go2_stops terrain --preset stops --robots 20 --conditions nominal
study_of go2-driven go2_backing terrain --preset backing --modes memory blind --conditions nominal
cp results/driving/commands/commands.png docs/figures/driven.png
python tools/tables.py --fill
