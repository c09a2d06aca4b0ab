#!/usr/bin/env bash
# Every entry of version 2's leaderboard, its table and its figure (docs/crossing.md):
#   benchmarks/leaderboard_2.sh GO1_POLICY.ONNX BUNDLE_WITHOUT_MEMORY [BUNDLE ...]
# The model is MuJoCo Playground's (examples/playground_policy.py), the bundle the earlier policy:
#   git archive 4410888 src/renet/pretrained/go1-parkour | tar x --transform s,.*parkour,without-memory,
# Further bundles are those of short trainings. All paths are from the repository's root.
# A study that is done is not run again.
set -euo pipefail
model=$1 earlier=$2
cd "$(dirname "$0")/.."
out=results/leaderboard_2 kept=benchmarks/results/leaderboard_2
mkdir -p "$kept"
renet evaluate benchmark --quick --modes memory switch camera blind oracle --out "$out/go1-parkour"
python examples/playground_policy.py evaluate playground-benchmark --quick --model "$model" --out "$out/playground"
renet evaluate benchmark --quick --modes memory camera blind --bundle "$earlier" --out "$out/without-memory"
for switch in return gate; do
    python benchmarks/switches.py "$switch" benchmark --study.quick --study.out "$out/$switch"
done
names=(go1-parkour without-memory return gate playground)
for bundle in "${@:3}"; do
    name=$(basename "$bundle") modes=(camera)
    [[ $name != renet-* ]] || modes=(memory camera blind)
    python benchmarks/baseline.py evaluate benchmark --quick --modes "${modes[@]}" --bundle "$bundle" --out "$out/$name"
    names+=("$name")
done
files=()
for name in "${names[@]}"; do
    cp "$out/$name/result.json" "$kept/$name.json"
    files+=("$kept/$name.json")
done
renet evaluate leaderboard "${files[@]}" --out "$kept/tables.md"
cp "$out/go1-parkour/crossing.png" docs/figures/crossing.png
python tools/tables.py --fill
