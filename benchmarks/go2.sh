#!/usr/bin/env bash
# Measures the Go2's policy that ships: every number about the Go2 in docs/results.md.
# Takes about 20 minutes on one core; parts of studies that are done are not run again.
set -euo pipefail
cd "$(dirname "$0")/.."
study() { # NAME COMMAND...: keeps its summary.json, of robots in nominal conditions.
    renet evaluate "${@:2}" --conditions nominal --bundle go2-parkour --out "results/go2/$1"
    cp "results/go2/$1/summary.json" "benchmarks/results/go2/$1.json"
}
version_1="gap:3 platform:6 stairs_up:6 stairs_down:10 obstacles:10"

study success terrain --preset success --modes camera blind
study standing terrain --preset standing
study memory memory
study blackout memory --grounds $version_1 --without 2 6
study noise faults --preset noise
study margins margins --quick --seconds 5
study severity_5 faults --severities 5 --onsets 1.5 --healthy-minutes 0 --modes camera memory blind
cp results/go2/memory/memory.png docs/figures/go2_memory.png
python tools/tables.py --fill
