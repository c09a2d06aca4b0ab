"""Somebody else's policy as a policy of the studies."""

import hashlib
import re
from dataclasses import replace
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest
import torch

from renet.errors import RenetError
from renet.evaluation.adapters.evaluator import AdaptedEvaluator, find_adapter
from renet.evaluation.adapters.options import PolicyOptions
from renet.interface import HEADING_PROPRIOCEPTION
from tests.evaluation.policies import STILL, joint_model, save_model, write_adapter

TWICE = "return senses.joint_position + self.model.run(senses.joint_position)[0]"


@pytest.fixture
def still(tmp_path):
    return save_model(tmp_path / "still.onnx", STILL)


def test_actions_are_those_of_the_model(still):
    evaluator = AdaptedEvaluator(still, "onnx-depth")
    policy = evaluator.make_policy(2)
    policy.reset()
    depth = np.full((2, 48, 64), 0.5, np.float32)
    action = policy.step(np.zeros((2, 45), np.float32), depth, np.zeros(2, bool))
    np.testing.assert_allclose(action, 0.005, atol=1e-6)


def test_a_heading_is_told_as_a_twist(still, monkeypatch):
    evaluator = AdaptedEvaluator(still, "onnx-depth")
    bundle = evaluator.bundle
    manifest = replace(bundle.manifest, proprioception=HEADING_PROPRIOCEPTION)
    evaluator.bundle = replace(bundle, manifest=manifest)
    policy = evaluator.make_policy(1)
    seen = []
    monkeypatch.setattr(policy._adapter, "act", lambda s: seen.append(s) or s.joint_position)
    proprioception = np.zeros((1, 45), np.float32)
    proprioception[0, 6:9] = 0.6, np.sin(0.2), np.cos(0.2)
    policy.step(proprioception, np.ones((1, 48, 64), np.float32), np.zeros(1, bool))
    np.testing.assert_allclose(seen[0].command, [[0.6, 0.0, 0.3]], atol=1e-6)


def test_robots_are_those_of_training_by_default_and_nominal_in_films(still):
    judged = AdaptedEvaluator(still, "onnx-depth").terrain_env_cfg("flat")
    assert {"motor_strength", "push"} <= set(judged.events)
    filmed = PolicyOptions(policy=still, adapter="onnx-depth").open_policy("native")
    assert filmed is not None
    assert filmed.terrain_env_cfg("flat").events.keys().isdisjoint({"motor_strength", "push"})


def test_another_file_is_another_policy(still, tmp_path):
    other = save_model(tmp_path / "other.onnx", STILL.replace("0.01", "0.02"))
    hashes = {AdaptedEvaluator(f, "onnx-depth").provenance(1).bundle_hash for f in (still, other)}
    assert len(hashes) == 2


def test_a_changed_adapter_of_ones_own_is_another_policy(tmp_path):
    model = joint_model(tmp_path / "twice.onnx", "y = Identity (x)")
    hashes = set()
    for act in (TWICE, "return senses.joint_position"):
        mine = write_adapter(tmp_path / "mine.py", act)
        hashes.add(AdaptedEvaluator(model, mine).provenance(1).bundle_hash)
    assert len(hashes) == 2


def test_the_hash_behind_an_adapter_of_renet_stays_that_of_published_results(still):
    words = b"Adapter" + b"renet.evaluation.adapters.onnx_depth"
    expected = hashlib.sha256(still.read_bytes() + words).hexdigest()
    assert AdaptedEvaluator(still, "onnx-depth").provenance(1).bundle_hash == expected


def test_a_wrong_adapter_is_told_before_anybody_walks(still):
    with pytest.raises(RenetError, match="the adapter gives 1; choose another --adapter"):
        AdaptedEvaluator(still, "robot-lab")


def test_an_adapter_of_ones_own(tmp_path):
    model = joint_model(tmp_path / "twice.onnx", "y = Identity (x)")
    evaluator = AdaptedEvaluator(model, write_adapter(tmp_path / "mine.py", TWICE))
    assert [*evaluator.entries] == ["blind"]
    assert evaluator.robot.damping == 1.0


def test_an_own_adapter_of_no_robot(still, tmp_path):
    mine = write_adapter(tmp_path / "mine.py", "return senses.joint_position", bundle="go2")
    with pytest.raises(RenetError, match=r"mine.py: bundle.*go2-parkour"):
        AdaptedEvaluator(still, mine)


def test_an_image_reaches_torchscript_as_it_reaches_onnx(still, tmp_path):
    class Still(torch.nn.Module):
        def forward(self, observation: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
            mean = depth.mean(dim=(1, 2)).reshape(-1, 1)
            return 0.01 * mean + 0.0 * observation[:, :12]

    torch.jit.save(torch.jit.script(Still()), tmp_path / "still.pt")
    walk = (np.zeros((2, 45), np.float32), np.full((2, 48, 64), 0.5, np.float32), np.zeros(2, bool))
    actions = []
    for path in (still, tmp_path / "still.pt"):
        policy = AdaptedEvaluator(path, "onnx-depth").make_policy(2)
        policy.reset()
        actions.append(policy.step(*walk))
    np.testing.assert_allclose(*actions, atol=1e-6)


ECHO = """
<ir_version: 8, opset_import: ["" : 17]>
echo (float[N, 45] observation) => (float[N, 12] action)
{
    starts = Constant <value_ints = [33]> ()
    ends = Constant <value_ints = [45]> ()
    axes = Constant <value_ints = [1]> ()
    last = Slice (observation, starts, ends, axes)
    one = Constant <value_float = 1.0> ()
    action = Add (last, one)
}
"""


def test_the_page_of_the_benchmark_shows_an_adapter_with_its_last_action(tmp_path):
    page = Path(__file__).parents[3] / "docs" / "benchmark.md"
    (block,) = re.findall(r"   ```python\n(.*?)   ```", page.read_text(), re.S)
    (tmp_path / "mine.py").write_text(dedent(block))
    echo = save_model(tmp_path / "echo.onnx", ECHO)
    evaluator = AdaptedEvaluator(echo, str(tmp_path / "mine.py"))
    assert evaluator.robot.name == "Unitree Go2"
    policy = evaluator.make_policy(2)
    policy.reset()
    walk = (np.zeros((2, 45), np.float32), np.ones((2, 48, 64), np.float32), np.zeros(2, bool))
    first = policy.step(*walk)
    policy.reset(np.array((True, False)))
    again = policy.step(*walk)
    np.testing.assert_allclose(again[0], first[0], atol=1e-5)
    np.testing.assert_allclose(again[1] - first[1], 0.25 / evaluator.robot.action_scale, atol=1e-5)


EIGHT = """
    starts = Constant <value_ints = [0]> ()
    ends = Constant <value_ints = [8]> ()
    axes = Constant <value_ints = [1]> ()
    y = Slice (x, starts, ends, axes)
"""


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (
            TWICE,
            r"^line 8 of adapter mine\.py fails with eight\.onnx, whose last run had"
            r" inputs \[1, 12\], outputs \[1, 8\]: ValueError: operands could not be broadcast",
        ),
        (
            "return self.model.run(senses.joint_position)[0]",
            r"mine.py with eight\.onnx gives joint targets of shape \[1, 8\]: \[1, 12\] finite",
        ),
        (
            "return self.model.run(senses.joint_position, senses.depth)",
            r"adapter gives 2; mend line 8 of adapter mine\.py$",
        ),
        ("return self.model.run(senses.gravity)", r"mend line 8 of adapter mine\.py$"),
        ("self.model.run", r"adapter mine\.py .* no array, as where `act` returns nothing"),
        (
            "return senses.joint_position * float('nan')",
            r"gives joint targets that are not finite: \[1, 12\]",
        ),
        (
            "return senses.nothing",
            r"^line 8 of adapter mine\.py fails with eight\.onnx: AttributeError: ",
        ),
        (
            "return 'text'",
            r"^adapter mine\.py fails with eight\.onnx: ValueError: could not convert",
        ),
    ],
)
def test_an_adapter_that_fails_is_told_in_one_line(tmp_path, act, message):
    eight = joint_model(tmp_path / "eight.onnx", EIGHT, outputs=8)
    with pytest.raises(RenetError, match=message) as error:
        AdaptedEvaluator(eight, write_adapter(tmp_path / "mine.py", act))
    assert "\n" not in str(error.value)


def test_an_adapter_that_fails_later_is_told_and_ctrl_c_is_not_swallowed(still, monkeypatch):
    policy = AdaptedEvaluator(still, "onnx-depth").make_policy(2)

    def act(error):
        def fail(*given):
            raise error

        monkeypatch.setattr(policy._adapter, "act", fail)
        monkeypatch.setattr(policy._adapter, "reset", fail)

    walk = (np.zeros((2, 45), np.float32), np.ones((2, 48, 64), np.float32), np.zeros(2, bool))
    act(KeyError("gait"))
    for fail in (lambda: policy.step(*walk), policy.reset):
        with pytest.raises(RenetError, match=r"fails with still\.onnx.*KeyError: 'gait'") as told:
            fail()
        assert isinstance(told.value.__cause__, KeyError)
    act(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        policy.step(*walk)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("import nowhere_at_all", "cannot be imported: ModuleNotFoundError"),
        ("Adapter = 3", "defines no class Adapter"),
    ],
)
def test_a_broken_adapter_is_told_in_one_line(tmp_path, source, message):
    (tmp_path / "mine.py").write_text(source)
    with pytest.raises(RenetError, match=message) as error:
        find_adapter(str(tmp_path / "mine.py"))
    assert "\n" not in str(error.value)


def test_an_unknown_adapter_is_told():
    with pytest.raises(RenetError, match="did you mean himloco"):
        find_adapter("himlocoo")
