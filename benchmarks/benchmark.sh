#!/usr/bin/env bash
# Walks renet-faults 3 with the policies that ship, rivals of their selector and policies of others:
# benchmark.sh FOLDER, which holds go1_policy.onnx, himloco.pt, go2_moe_cts_124k.pt and robot_lab.pt
# (docs/benchmark.md says where they are).
set -euo pipefail
models=$(realpath "${1:?name the folder of the models}")
# What is missing is told at once, not after hours.
for file in go1_policy.onnx himloco.pt go2_moe_cts_124k.pt robot_lab.pt; do
    [[ -f $models/$file ]] || { echo "benchmark.sh: there is no $models/$file" >&2; exit 2; }
done
cd "$(dirname "$0")/.."
kept=benchmarks/results/benchmark
mkdir -p "$kept/full"

walk() { # NAME COMMAND...: keeps the result of all 200 episodes.
    "${@:2}" "results/benchmark/full/$1"
    cp "results/benchmark/full/$1/result.json" "$kept/full/$1.json"
}
judge() { # NAME ARGUMENTS...
    walk "$1" python benchmarks/judges.py "${@:2}" --study.out
}
theirs() { # NAME FILE
    walk "$1" renet evaluate benchmark --jobs 2 --policy "$models/$2" --adapter "$1" --method "$1" --out
}

for bundle in go1-parkour go2-parkour; do
    walk "$bundle" renet evaluate benchmark --jobs 2 --bundle "$bundle" --out
done
judge oracle oracle
judge oracle_withholds oracle --withholds
judge gate gate
judge gate_withholds gate --withholds
judge return return
theirs playground go1_policy.onnx
theirs himloco himloco.pt
theirs robogauge go2_moe_cts_124k.pt
theirs robot-lab robot_lab.pt

python benchmarks/paper/kilometre.py --laps 1 --robots 20 --out results/benchmark/kilometre
cp results/benchmark/kilometre/summary.json "$kept/kilometre.json"
python tools/tables.py --fill
