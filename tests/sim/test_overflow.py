"""A box with more contacts than the buffers hold, on MuJoCo Warp's CPU backend."""

import warnings

import pytest
import torch
from mjlab.sim.sim import MujocoCfg, Simulation, SimulationCfg
from tests.sim.scenes import PLANE, scene

from renet.sim.overflow import OverflowWatch

BOX = '<body pos="0 0 1"><freejoint/><geom type="box" size=".1 .1 .1"/></body>'


def test_overflow_is_counted_and_reported():
    cfg = SimulationCfg(njmax=4, nconmax=20, mujoco=MujocoCfg(timestep=0.005))
    simulation = Simulation(3, cfg, scene(PLANE, BOX), "cpu")
    watch = OverflowWatch(simulation)
    simulation.step()
    watch.look()
    with warnings.catch_warnings(action="error"):
        assert watch.report() == {"overflow_contacts": 0, "overflow_constraints": 0}
    simulation.data.qpos[1, 2] = 0.09  # Four corners touch; friction makes 16 rows.
    simulation.step()
    watch.look()
    simulation.reset(torch.tensor([1]))
    watch.look()  # What the engine has forgotten is still remembered.
    with pytest.warns(UserWarning, match=r"more constraints .* Raise `sim.njmax`"):
        assert watch.report() == {"overflow_contacts": 0, "overflow_constraints": 1}
    assert watch.report()["overflow_constraints"] == 0
