"""Skipping what is out of reach must change nothing."""

import mujoco
import numpy as np
import pytest
import torch
from tests.sim.scenes import scene, simulate

from renet.sim.native import collision_culling
from renet.sim.native.engine import NativeSimulation
from renet.tasks import make_env

BOT = """<body name="robot" pos="0 0 1"><freejoint/><geom size="0.1"/>
  <body pos="0.3 0 0"><joint axis="0 1 0" pos="0 0 .05"/><geom size="0.1" pos="0.2 0 0"/></body>
</body>"""
TABLE = '<body name="t{0}" pos="{1} 0 0" euler="0 0 {2}"><geom type="box" size="1 0.5 0.2"/></body>'
TABLES = "".join(TABLE.format(i, 4 * i, 30 * i) for i in range(5))


def move(sim: NativeSimulation, *x: float) -> None:
    sim.data.qpos[:, 0] = torch.tensor(x)
    sim.forward()


def look(model: mujoco.MjModel, *x: float) -> NativeSimulation:
    """A simulation that has looked where robots are, at `x`."""
    sim = simulate(model, len(x))
    move(sim, *x)
    return sim


def touchable(sim: NativeSimulation, robot: int = 0) -> list[bool]:
    """Whether a robot's world lets each table collide."""
    contype, conaffinity = (masks[robot] for masks in sim.culling.masks)
    tables = [sim.mj_model.body(f"t{i}").id for i in range(5)]
    assert (contype[tables] == conaffinity[tables]).all()
    return contype[tables].astype(bool).tolist()


def test_only_tables_within_reach_can_be_touched():
    here = look(model := scene(TABLES, BOT), 4.0)
    # Radius 0.3 + 2 * 0.05 + 0.2 + 0.1 around the root, as the hinge shifts the link's frame, and
    # the travel; tables are up to 1 m long.
    assert here.culling.fields["reach"] == pytest.approx([0.7 + collision_culling.TRAVEL])
    assert touchable(here) == [False, True, False, False, False]
    assert here.culling.masks[0][0, model.body("robot").id]
    assert all(touchable(look(model, np.nan))), "a lost position is near everything"


@pytest.mark.parametrize(
    "more",
    [
        '<body mocap="true"><geom size="0.1"/></body>',
        '<body><joint type="slide"/><geom size="0.1"/></body>',
        '<body><joint type="hinge"/><geom size="0.1"/></body>',
    ],
)
def test_unbounded_reach_keeps_all_contacts(more):
    model = scene(TABLES, BOT, more)
    here = look(model, 0.0)
    assert here.culling.load_masks(model) == []
    assert all(touchable(here))


def test_bodies_come_into_reach():
    sim = look(scene(TABLES, BOT), 0.0, 16.0)
    for x in np.arange(0.0, 16.0, 0.1):
        move(sim, x, 16.0 - x)
        for robot, at in enumerate((x, 16.0 - x)):
            turn, table = np.pi / 6 * np.arange(5), 4.0 * np.arange(5)
            gap = abs(at - table) - abs(np.cos(turn)) - 0.5 * abs(np.sin(turn))
            here = np.array(touchable(sim, robot))
            # Looked at again each 25 cm: between the two either is right.
            assert here[gap < 0.94].all()
            assert not here[gap > 1.46].any()


def rollout() -> dict[str, torch.Tensor]:
    """Rewards, and the last state and what is observed of it."""
    env = make_env("Renet-Go1-Parkour", 6, seed=3)
    env.reset()
    actions = torch.Generator().manual_seed(0)
    rewards = []
    for _ in range(40):
        observations, reward, *_ = env.step(0.5 * torch.randn(6, 12, generator=actions))
        rewards.append(reward.clone())
    return {"rewards": torch.stack(rewards), "state": env.sim.data.qpos[:].clone(), **observations}


def test_culling_changes_no_fall(monkeypatch):
    """And the same seed draws the same levels, noise and randomisation."""
    culled = rollout()
    monkeypatch.setattr(collision_culling, "_bounded_static_bodies", lambda model: np.empty(0, int))
    torch.testing.assert_close(culled, rollout(), atol=0, rtol=0)
