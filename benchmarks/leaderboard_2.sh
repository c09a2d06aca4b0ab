#!/usr/bin/env bash
# Every entry of version 2's leaderboard, its table and its figure (docs/crossing.md):
#   benchmarks/leaderboard_2.sh GO1_POLICY.ONNX BUNDLE_WITHOUT_MEMORY
# The model is MuJoCo Playground's (examples/playground_policy.py), the bundle the earlier policy:
#   git archive 4410888 src/renet/pretrained/go1-parkour | tar x --transform s,.*parkour,without-memory,
# Both paths are from the repository's root.
# A study that is done is not run again.
set -euo pipefail
model=$1 earlier=$2
cd "$(dirname "$0")/.."
out=results/leaderboard_2 kept=benchmarks/results/leaderboard_2
mkdir -p "$kept"
renet evaluate benchmark --quick --modes renet paper vp op oracle-switch --out "$out/go1-parkour"
python examples/playground_policy.py evaluate playground-benchmark --quick --model "$model" --out "$out/playground"
renet evaluate benchmark --quick --modes renet vp op --bundle "$earlier" --out "$out/without-memory"
for switch in return gate; do
    python benchmarks/switches.py "$switch" benchmark --study.quick --study.out "$out/$switch"
done
files=()
for name in go1-parkour without-memory return gate playground; do
    cp "$out/$name/result.json" "$kept/$name.json"
    files+=("$kept/$name.json")
done
renet evaluate leaderboard "${files[@]}" --out "$kept/tables.md"
cp "$out/go1-parkour/crossing.png" docs/figures/crossing.png
python tools/tables.py --fill
