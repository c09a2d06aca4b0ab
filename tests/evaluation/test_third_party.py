"""The example that benchmarks somebody else's policy, on a policy that stands still."""

import json
from hashlib import sha256
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

import third_party_policy as example
from renet.evaluation.studies.faults import FaultStudy


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Action = 0 · observation + mean depth, to see what the policy is shown."""
    weights = helper.make_tensor("weights", TensorProto.FLOAT, (45, 12), [0.0] * 540)
    nodes = [
        helper.make_node("MatMul", ["observation", "weights"], ["nothing"]),
        helper.make_node("ReduceMean", ["depth"], ["means"], axes=[1, 2], keepdims=0),
        helper.make_node("Unsqueeze", ["means", "one"], ["column"]),
        helper.make_node("Mul", ["column", "little"], ["small"]),
        helper.make_node("Add", ["nothing", "small"], ["action"]),
    ]
    graph = helper.make_graph(
        nodes,
        "still",
        [
            helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["N", 45]),
            helper.make_tensor_value_info("depth", TensorProto.FLOAT, ["N", 48, 64]),
        ],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["N", 12])],
        [
            weights,
            helper.make_tensor("one", TensorProto.INT64, (1,), [1]),
            helper.make_tensor("little", TensorProto.FLOAT, (1,), [0.01]),
        ],
    )
    path = tmp_path_factory.mktemp("theirs") / "still.onnx"
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path
    )
    return path


def test_a_blind_policy_sees_nothing_near(model: Path) -> None:
    policy = example.TheirPolicy(model, 2)
    depth = np.full((2, 48, 64), 0.25, np.float16)
    action = policy.step(np.zeros((2, 45), np.float32), depth, np.array([False, True]))
    np.testing.assert_allclose(action[:, 0], [0.0025, 0.01])


def test_it_enters_the_leaderboard_with_one_command(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = {"faults": ("frozen:3",), "grounds": ("flat", "gap"), "robots": 1, "healthy_minutes": 0}
    small |= {"onsets": (0.5,), "lasts": 0.2, "seconds": 0.8, "quick": False}
    monkeypatch.setattr(example, "FaultStudy", lambda **given: FaultStudy(**(given | small)))
    example.main(model, tmp_path)
    summary = json.loads((tmp_path / "still" / "summary.json").read_text())
    assert summary["provenance"]["bundle_hash"] == sha256(model.read_bytes()).hexdigest()
    assert {run["falls"] for run in summary["runs"]} == {0}
    board = (tmp_path / "leaderboard.md").read_text().splitlines()
    assert sorted(line.split(" | ")[1:3] for line in board[2:]) == [
        ["still", mode] for mode in ("op", "renet", "vp")
    ]
