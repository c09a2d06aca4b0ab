"""The example that benchmarks somebody else's policy, on a policy that stands still."""

import json
import re
import runpy
import sys
from hashlib import sha256

import numpy as np
import pytest

import playground_policy
import third_party_policy as example
from renet.errors import RenetError
from renet.evaluation.studies.faults import FaultStudy
from tests.evaluation.policies import STILL, save_model


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return save_model(tmp_path_factory.mktemp("theirs") / "still.onnx", STILL)


def test_a_blind_policy_sees_nothing_near(model):
    policy = example.TheirPolicy(model, 2)
    depth = np.full((2, 48, 64), 0.25, np.float16)
    action = policy.step(np.zeros((2, 45), np.float32), depth, np.array([False, True]))
    np.testing.assert_allclose(action[:, 0], [0.0025, 0.01])


@pytest.mark.parametrize(
    ("theirs", "message"),
    [
        ("float[1, 48] obs", r"theirs.onnx has obs \[1, 48\], action \[1, 48\]; a study gives"),
        ("float[1, 45] observation", "no base velocity"),
        ("float[N, 45] observation, float[N, 64, 64] depth", r"depth \[N, 48, 64\] in \[0, 1\]"),
    ],
)
def test_a_model_with_other_inputs_is_told_what_it_is_given(tmp_path, theirs, message):
    size, name = theirs.split("] ")[0] + "]", theirs.split("] ")[1].split(",")[0]
    text = f'<ir_version: 8, opset_import: ["" : 17]>\nt ({theirs}) => ({size} action)'
    model = save_model(tmp_path / "theirs.onnx", f"{text} {{ action = Identity ({name}) }}")
    with pytest.raises(RenetError, match=message) as error:
        example.TheirPolicy(model, 2)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot read .*theirs.pt: No such file.*"),
        (b"PK\3\4", ".*theirs.pt is no ONNX model: .*"),
    ],
)
def test_a_file_that_is_no_model_ends_in_one_line(tmp_path, monkeypatch, capsys, content, message):
    path = tmp_path / "theirs.pt"
    if content is not None:
        path.write_bytes(content)
    results = tmp_path / "results"
    monkeypatch.setattr(sys, "argv", ["example", str(path), "--results", str(results)])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(example.__file__, run_name="__main__")
    assert ended.value.code == 2
    assert re.fullmatch(message, capsys.readouterr().err.rstrip("\n"))
    assert not results.exists()


def test_it_is_studied_with_one_command(model, tmp_path, monkeypatch, capsys):
    small = {"faults": ("frozen:3",), "grounds": ("flat", "gap"), "healthy_minutes": 0}
    small |= {"onsets": (0.5,), "lasts": 0.2, "seconds": 0.8}
    monkeypatch.setattr(example, "FaultStudy", lambda **given: FaultStudy(**(given | small)))
    example.main(model, tmp_path)
    summary = json.loads((tmp_path / "still" / "summary.json").read_text())
    assert summary["provenance"]["bundle_hash"] == sha256(model.read_bytes()).hexdigest()
    assert {run["falls"] for run in summary["runs"]} == {0}
    assert "frozen" in capsys.readouterr().out


PLAYGROUND = """
<ir_version: 8, opset_import: ["" : 9]>
theirs (float[1, 48] obs) => (float[1, 12] continuous_actions)
{
    continuous_actions = Slice <starts = [0], ends = [12], axes = [1]> (obs)
}
"""
"""Its action repeats what it sees first: velocity, turn rate, gravity, three joints."""


def test_playgrounds_policy_alone_sees_the_simulator_in_its_own_order(model, tmp_path):
    theirs = save_model(tmp_path / "go1_policy.onnx", PLAYGROUND)
    study = playground_policy.CameraUse(model=theirs, conditions="nominal")
    evaluator = study.make_evaluator()
    env = evaluator.make_env("flat", range(2), 0.6, 1)
    result = env.reset()
    seen = evaluator.make_policy(2).step(result.proprioception, result.depth, None) / 2.0
    np.testing.assert_allclose(seen[:, :3], env.observation["velocity"], atol=1e-6)
    np.testing.assert_allclose(seen[:, 3:6], result.angular_velocity, atol=0.7)
    np.testing.assert_allclose(seen[:, 6:9], [[0, 0, -1]] * 2, atol=0.2)
    np.testing.assert_allclose(seen[:, 9:12], result.proprioception[:, 9:12], atol=1e-6)
    driven = playground_policy.CameraUse(model=theirs, motors="go1").make_evaluator()
    assert driven.motors is not None
    another = playground_policy.CameraUse(model=model).make_evaluator()
    with pytest.raises(RenetError, match="is not Playground's Go1 policy"):
        another.make_policy(2)


@pytest.mark.parametrize(
    "make",
    [
        lambda file: example.TheirPolicy(file, 1),
        lambda file: playground_policy.PlaygroundPolicy(file, 1, None),
    ],
    ids=["third party", "playground"],
)
def test_a_file_that_is_no_model_is_named(make, tmp_path):
    file = tmp_path / "policy.onnx"
    file.write_text("no model")
    with pytest.raises(RenetError, match=r"policy\.onnx is no ONNX model"):
        make(file)
