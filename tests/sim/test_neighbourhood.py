"""Skipping what is out of reach must change nothing."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO

import mujoco
import numpy as np
import pytest
import torch

from renet.sim import neighbourhood
from renet.sim.neighbourhood import MASKS, Neighbourhood
from renet.tasks import make_env

ROW_OF_TABLES = """
<mujoco>
  <worldbody>
    {tables}
    <body name="robot" pos="0 0 1"><freejoint/><geom size="0.1"/>
      <body pos="0.3 0 0"><joint axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body></body>
    {more}
  </worldbody>
</mujoco>
"""
TABLE = '<body name="t{0}" pos="{1} 0 0" euler="0 0 {2}"><geom type="box" size="1 0.5 0.2"/></body>'


def scene(more: str = "") -> mujoco.MjModel:
    tables = "".join(TABLE.format(i, 4 * i, 30 * i) for i in range(5))
    return mujoco.MjModel.from_xml_string(ROW_OF_TABLES.format(tables=tables, more=more))


def look(model: mujoco.MjModel, qpos: np.ndarray) -> tuple[Neighbourhood, mujoco.MjModel]:
    """The neighbourhood of one robot, and the model with its masks loaded."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    here = Neighbourhood(model, data, 1)
    here.update(qpos[None])
    for name, mask in zip(MASKS, here._masks, strict=True):
        getattr(model, name)[:] = mask[0]
    return here, model


def touchable(model: mujoco.MjModel) -> list[bool]:
    """Whether each table can collide."""
    return [bool(model.body_contype[model.body(f"t{i}").id]) for i in range(5)]


def test_only_tables_within_reach_can_be_touched():
    model = scene()
    qpos = model.qpos0.copy()
    qpos[0] = 4.0
    here, model = look(model, qpos)
    # Radius 0.3 + 0.2 + 0.1 around the root, and the travel; tables are up to 1 m long.
    assert here._reach == pytest.approx([0.6 + neighbourhood.TRAVEL])
    assert touchable(model) == [False, True, False, False, False]
    assert model.body_contype[model.body("robot").id]


def test_a_lost_position_is_near_everything():
    model = scene()
    qpos = model.qpos0.copy()
    qpos[0] = np.nan
    _, model = look(model, qpos)
    assert all(touchable(model))


@pytest.mark.parametrize(
    "more",
    [
        '<body mocap="true"><geom size="0.1"/></body>',
        '<body><joint type="slide"/><geom size="0.1"/></body>',
        '<body><joint type="hinge"/><geom size="0.1"/></body>',
    ],
)
def test_models_whose_reach_is_unknown_keep_every_contact(more):
    model = scene(more)
    here, model = look(model, model.qpos0)
    assert here.rows(model) == []
    assert all(touchable(model))


def rewards(steps: int) -> tuple[torch.Tensor, torch.Tensor]:
    with redirect_stdout(StringIO()):
        env = make_env("Renet-Go1-Parkour", 6, seed=3)
    env.reset()
    actions = torch.Generator().manual_seed(0)
    collected = [
        env.step(0.5 * torch.randn(6, 12, generator=actions))[1].clone() for _ in range(steps)
    ]
    return torch.stack(collected), env.sim.data.qpos[:].clone()


def test_robots_on_tiles_fall_alike_with_and_without_the_tiles_out_of_reach(monkeypatch):
    culled = rewards(40)
    monkeypatch.setattr(neighbourhood, "_bounded_static_bodies", lambda model: np.empty(0, int))
    whole = rewards(40)
    assert torch.equal(culled[0], whole[0])
    assert torch.equal(culled[1], whole[1])
