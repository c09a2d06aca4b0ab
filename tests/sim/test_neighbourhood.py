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


def test_tables_come_into_reach_as_the_robot_walks():
    model = scene()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    walking = Neighbourhood(model, data, 2)
    qpos = np.tile(model.qpos0, (2, 1))
    for x in np.arange(0.0, 16.0, 0.1):
        qpos[:, 0] = x, 16.0 - x
        walking.update(qpos)
        alone = [Neighbourhood(model, data, 1) for _ in range(2)]
        for robot, fresh in enumerate(alone):
            fresh._reach = [reach - neighbourhood.TRAVEL / 2 for reach in fresh._reach]
            fresh.update(qpos[robot : robot + 1])
            # What is near when looked at anew, closely, is near.
            assert (walking._masks[0][robot] >= fresh._masks[0][0]).all()
        assert walking._masks[0].any(axis=-1).all()
        assert not walking._masks[0][:, 1:-1].all(axis=-1).any()


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
