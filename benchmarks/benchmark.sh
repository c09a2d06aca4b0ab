#!/usr/bin/env bash
# Walks renet-faults 3 with the policy that ships and oracles of its selector, and its quick set with
# more rivals and policies of others: benchmark.sh FOLDER, which holds go1_policy.onnx, himloco.pt,
# go2_moe_cts_124k.pt and robot_lab.pt (docs/benchmark.md says where they are).
set -euo pipefail
models=$1
cd "$(dirname "$0")/.."
kept=benchmarks/results/benchmark
mkdir -p "$kept"
keep() { cp "results/benchmark/$1/result.json" "$kept/$1.json"; }
theirs() { # NAME FILE ADAPTER
    renet evaluate benchmark --quick --policy "$models/$2" --adapter "$3" --method "$1" \
        --out "results/benchmark/$1"
    keep "$1"
}
judge() { # NAME ARGUMENTS...
    python benchmarks/judges.py "${@:2}" --study.quick --study.out "results/benchmark/$1"
    keep "$1"
}

mkdir -p "$kept/full"
full() { # NAME COMMAND...: keeps the result of all 200 episodes.
    "${@:2}" "results/benchmark/full/$1"
    cp "results/benchmark/full/$1/result.json" "$kept/full/$1.json"
}
full go1-parkour renet evaluate benchmark --jobs 2 --out
full oracle python benchmarks/judges.py oracle --study.out
full oracle_withholds python benchmarks/judges.py oracle --withholds --study.out
full himloco renet evaluate benchmark --jobs 2 --policy "$models/himloco.pt" --adapter himloco \
    --method himloco --out
full robot-lab renet evaluate benchmark --jobs 2 --policy "$models/robot_lab.pt" --adapter robot-lab \
    --method robot-lab --out
full robogauge renet evaluate benchmark --jobs 2 --policy "$models/go2_moe_cts_124k.pt" --adapter robogauge \
    --method robogauge --out

for bundle in go1-parkour go2-parkour; do
    renet evaluate benchmark --quick --bundle "$bundle" --out "results/benchmark/$bundle"
    keep "$bundle"
done
theirs playground go1_policy.onnx playground
theirs himloco himloco.pt himloco
theirs robogauge go2_moe_cts_124k.pt robogauge
theirs robot-lab robot_lab.pt robot-lab
judge oracle oracle
judge oracle_withholds oracle --withholds
judge gate gate
judge gate_withholds gate --withholds
judge return return
python benchmarks/paper/kilometre.py --laps 1 --robots 5 --out results/benchmark/kilometre
cp results/benchmark/kilometre/summary.json "$kept/kilometre.json"
python tools/tables.py --fill
