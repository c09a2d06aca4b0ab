"""Every row of the paper's table trains, and differs in exactly the part it names."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import tyro
from mjlab.rl import RslRlVecEnvWrapper

from renet.cli import parse
from renet.curves import CURVES, read_curves
from renet.models.config import ModelCfg
from renet.models.oracle import true_image
from renet.models.renet import RENet
from renet.tasks import make_env
from renet.training.config import SupervisionCfg
from renet.training.provenance import to_json
from renet.training.train import TrainCfg

from .conftest import ToyEnv, make_runner

OP = {"op_velocity", "op_him"}
VP = {"vp_velocity", "vp_him", "vp_feet_height", "vp_height_map"}


class Row(NamedTuple):
    """What is set in ModelCfg, how names of layers that change begin, and which losses go."""

    fields: dict[str, Any]
    layers: set[str]
    missing: set[str]


ROWS = {
    "default": Row({}, set(), set()),
    "Oracle": Row({"perception": "oracle"}, set(), OP),
    "MLP": Row({"encoder": "mlp"}, {"op.encoder", "vp.encoder"}, set()),
    "w/o VEL": Row(
        {"predict_velocity": False},
        {"op.velocity_head", "vp.velocity_head"},
        {"op_velocity", "vp_velocity"},
    ),
    "w/o FH": Row({"predict_feet_height": False}, {"vp.feet_height_head"}, {"vp_feet_height"}),
    "w/o HF": Row({"predict_height_map": False}, {"vp.height_map_head"}, {"vp_height_map"}),
    "w/o HIM": Row({"him": False}, {"op_him", "vp_him"}, {"op_him", "vp_him"}),
    "One Obs": Row({"history": 1}, {"op.proprioception.1", "vp.proprioception.1"}, set()),
    "One Image": Row({"frames": 1}, {"vp.depth.convolutions.0"}, set()),
    "VP-only": Row({"perception": "vp"}, set(), OP),
    "OP-only": Row({"perception": "op"}, set(), VP),
}


@pytest.fixture(scope="module")
def losses(tmp_path_factory) -> Callable[[str], set[str]]:
    """Names of what a row learns in two iterations, without what HIM is watched by."""
    env = RslRlVecEnvWrapper(make_env("Renet-Go1-Parkour", 6), clip_actions=4.8)

    @cache
    def train(row: str) -> set[str]:
        folder = tmp_path_factory.mktemp("run")
        model, teaching = ModelCfg(**ROWS[row].fields), SupervisionCfg(estimator_data="all")
        make_runner(env, folder, model=model, num_steps_per_env=5, supervision=teaching).learn(2)
        curves = {
            name.removeprefix("Loss/") for name in read_curves(folder / CURVES) if "Loss/" in name
        }
        return {name for name in curves if not name.endswith(("_rank", "_usage"))}

    yield train
    env.close()


@pytest.mark.parametrize("row", ROWS)
def test_trains_without_the_named_losses(losses, row):
    assert {"surrogate", "value", "anomaly"} <= losses(row)
    assert losses("default") ^ losses(row) == ROWS[row].missing
    assert ROWS[row].missing <= losses("default")


def parameters(**fields) -> dict[str, tuple[int, ...]]:
    model = RENet(ModelCfg(**fields), critic_size=10)
    return {name: tuple(value.shape) for name, value in model.named_parameters()}


@pytest.mark.parametrize("row", ROWS)
def test_differs_in_the_layers_it_names(row):
    default, ablated = parameters(), parameters(**ROWS[row].fields)
    changed = {n for n in {**default, **ablated} if default.get(n) != ablated.get(n)}
    assert all(name.startswith(tuple(ROWS[row].layers)) for name in changed)
    assert all(any(n.startswith(beginning) for n in changed) for beginning in ROWS[row].layers)


def test_options_change_exactly_one_field():
    """Each row of the table of ablations; the parser of `renet train` reads one of them."""
    page = (Path(__file__).parents[2] / "benchmarks" / "NOTES.md").read_text()
    options = r"^\| ([\w/ ()-]+?) \| `(--agent\.model\.[^`]+)` \|"
    table = dict(re.findall(options, page, re.MULTILINE))
    assert set(table) == (set(ROWS) - {"default"}), "every row of the table is documented"
    for name, line in table.items():
        options = line.replace("--agent.model.", "--").split()
        model = tyro.cli(ModelCfg, args=options, config=TrainCfg.tyro_flags)
        assert model == ModelCfg(**ROWS[name].fields)
    default = TrainCfg.from_task("Renet-Go1-Flat")
    cfg = parse(TrainCfg, ["Renet-Go1-Flat", *table["One Obs"].split()], "")
    assert cfg.agent.model == replace(default.agent.model, history=1)
    assert replace(cfg.agent, model=default.agent.model) == default.agent
    assert to_json(cfg.env) == to_json(default.env)


def test_the_oracle_sees_the_true_map():
    env = ToyEnv()
    alg, obs = make_runner(env, model=ModelCfg(perception="oracle")).alg, env.get_observations()
    alg.act(obs)
    assert (alg.memory.frames == true_image(obs["height_map"]).half().unsqueeze(1)).all()
