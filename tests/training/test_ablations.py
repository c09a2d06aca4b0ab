"""Every row of the paper's table trains, exports, and differs in exactly the part it names."""

from __future__ import annotations

import re
from contextlib import redirect_stdout
from dataclasses import asdict
from io import StringIO
from pathlib import Path

import pytest
import torch
import tyro
from mjlab.rl import RslRlVecEnvWrapper

from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.tasks import make_env
from renet.training.config import LearningCfg
from renet.training.export import export_models
from renet.training.metrics import read_curves
from renet.training.runner import RenetRunner
from renet.training.train import TrainCfg

ROWS = {
    "default": {},
    "Oracle": {"perception": "oracle"},
    "MLP": {"encoder": "mlp"},
    "w/o VEL": {"predict_velocity": False},
    "w/o FH": {"predict_feet_height": False},
    "w/o HF": {"predict_height_map": False},
    "w/o HIM": {"him": False},
    "One Obs": {"history": 1},
    "One Image": {"frames": 1},
    "VP-only": {"perception": "vp"},
    "OP-only": {"perception": "op"},
}


@pytest.fixture(scope="module")
def env():
    with redirect_stdout(StringIO()):
        made = make_env("Renet-Go1-Parkour", 16)
    yield RslRlVecEnvWrapper(made, clip_actions=4.8)
    made.close()


@pytest.mark.parametrize("fields", ROWS.values(), ids=ROWS)
def test_trains_and_exports(env, tmp_path, fields):
    env.reset()
    cfg = LearningCfg(model=ModelCfg(**fields))
    runner = RenetRunner(env, asdict(cfg), str(tmp_path), "cpu")
    runner.learn(3)
    losses = {name for name in read_curves(tmp_path) if name.startswith("Loss/")}
    assert {"Loss/surrogate", "Loss/value", "Loss/anomaly"} <= losses
    if fields.get("perception") != "oracle":
        assert set(export_models(runner.alg.model)) == {"actor", "estimator", "vision"}


def parameters(**fields) -> dict[str, tuple[int, ...]]:
    model = RENet(ModelCfg(**fields), critic_size=10)
    return {name: tuple(value.shape) for name, value in model.named_parameters()}


@pytest.mark.parametrize(
    ("fields", "removed", "reshaped"),
    [
        (
            ROWS["w/o VEL"],
            {"op.velocity_head.weight", "op.velocity_head.bias"}
            | {"vp.velocity_head.weight", "vp.velocity_head.bias"},
            set(),
        ),
        (ROWS["w/o FH"], {"vp.feet_height_head.weight", "vp.feet_height_head.bias"}, set()),
        (
            ROWS["w/o HF"],
            {f"vp.height_map_head.{i}.{kind}" for i in (0, 2) for kind in ("weight", "bias")},
            set(),
        ),
        (
            ROWS["One Obs"],
            set(),
            {"op.proprioception.1.weight", "vp.proprioception.1.weight"},
        ),
        (ROWS["One Image"], set(), {"vp.depth.convolutions.0.weight"}),
        (ROWS["Oracle"], set(), {"actor.mean.0.weight"}),
        (ROWS["VP-only"], set(), set()),
        (ROWS["OP-only"], set(), set()),
    ],
    ids=["VEL", "FH", "HF", "One Obs", "One Image", "Oracle", "VP-only", "OP-only"],
)
def test_differs_in_the_part_it_names(fields, removed, reshaped):
    default, ablated = parameters(), parameters(**fields)
    assert set(default) - set(ablated) == removed
    assert not set(ablated) - set(default)
    assert {n for n in ablated if ablated[n] != default[n]} == reshaped


def test_him_and_encoder_differ_only_in_their_modules():
    default = parameters()
    without = parameters(him=False)
    assert {n.split(".")[0] for n in set(default) - set(without)} == {"op_him", "vp_him"}
    mlp = parameters(encoder="mlp")
    changed = {n for n in set(default) ^ set(mlp)} | {
        n for n in set(default) & set(mlp) if default[n] != mlp[n]
    }
    assert {tuple(n.split(".")[:2]) for n in changed} == {("op", "encoder"), ("vp", "encoder")}


@pytest.mark.parametrize(
    ("fields", "missing"),
    [
        (ROWS["w/o VEL"], {"op_velocity", "vp_velocity"}),
        (ROWS["w/o FH"], {"vp_feet_height"}),
        (ROWS["w/o HF"], {"vp_height_map"}),
        (ROWS["w/o HIM"], {"op_him", "vp_him"}),
        (ROWS["OP-only"], {"vp_velocity", "vp_him", "vp_feet_height", "vp_height_map"}),
        (ROWS["VP-only"], {"op_velocity", "op_him"}),
        (
            ROWS["Oracle"],
            {"op_velocity", "op_him"}
            | {"vp_velocity", "vp_him", "vp_feet_height", "vp_height_map"},
        ),
        (ROWS["MLP"], set()),
        (ROWS["One Obs"], set()),
        (ROWS["One Image"], set()),
    ],
    ids=["VEL", "FH", "HF", "HIM", "OP-only", "VP-only", "Oracle", "MLP", "One Obs", "One Image"],
)
def test_losses_differ_in_the_part_it_names(toy_env, tmp_path, fields, missing):
    def losses(**changes) -> set[str]:
        torch.manual_seed(0)
        cfg = LearningCfg(model=ModelCfg(**changes), num_steps_per_env=5)
        cfg.supervision.estimator_data = "all"
        runner = RenetRunner(toy_env(), asdict(cfg), None, "cpu")
        runner._iterate(runner.env.get_observations(), 0, 1)
        obs = runner.env.get_observations()
        for _ in range(5):
            runner.alg.act(obs)
            obs, reward, done, extras = runner.env.step(torch.zeros(8, 12))
            runner.alg.process_env_step(obs, reward, done, extras)
        runner.alg.compute_returns(obs)
        # What HIM is watched by is no loss.
        return {n for n in runner.alg.update() if not n.endswith(("_rank", "_usage"))}

    assert losses() ^ losses(**fields) == missing
    assert missing <= losses()


def test_the_pages_options_change_exactly_the_field_they_name():
    """Each row of the table in docs/method.md, through the parser of `renet train`."""
    page = (Path(__file__).parents[2] / "docs" / "method.md").read_text()
    table = dict(re.findall(r"^\| ([\w/ ()-]+?) \| `(--model\.[^`]+)` \|", page, re.MULTILINE))
    assert set(table) == (set(ROWS) - {"default"}), "every row of the table is documented"
    default = asdict(tyro.cli(TrainCfg, args=["Renet-Go1-Flat"]))
    for name, options in table.items():
        cfg = asdict(tyro.cli(TrainCfg, args=["Renet-Go1-Flat", *options.split()]))
        model, own = cfg.pop("model"), dict(default)
        changed = {key: value for key, value in model.items() if own["model"][key] != value}
        assert changed == ROWS[name]
        own.pop("model")
        assert cfg == own
