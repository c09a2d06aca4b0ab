"""A box with more contacts than the buffers hold, on MuJoCo Warp's CPU backend."""

import warnings

import mujoco
import pytest
import torch
from mjlab.sim.sim import MujocoCfg, Simulation, SimulationCfg

from renet.sim.overflow import OverflowWatch

BOX = """<mujoco><worldbody><geom type="plane" size="1 1 .1"/>
<body pos="0 0 1"><freejoint/><geom type="box" size=".1 .1 .1"/></body></worldbody></mujoco>"""


def boxes(njmax: int) -> Simulation:
    cfg = SimulationCfg(njmax=njmax, nconmax=20, mujoco=MujocoCfg(timestep=0.005))
    return Simulation(3, cfg, mujoco.MjModel.from_xml_string(BOX), "cpu")


def test_constraints_that_do_not_fit_are_counted_and_told():
    simulation = boxes(njmax=4)
    watch = OverflowWatch(simulation)
    simulation.step()
    watch.look()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert watch.report() == {"overflow_contacts": 0, "overflow_constraints": 0}
    simulation.data.qpos[1, 2] = 0.09  # Four corners touch; friction makes 16 rows.
    simulation.step()
    watch.look()
    simulation.reset(torch.tensor([1]))
    watch.look()  # What the engine has forgotten is still remembered.
    with pytest.warns(UserWarning, match=r"more constraints .* Raise `sim.njmax`"):
        assert watch.report() == {"overflow_contacts": 0, "overflow_constraints": 1}
    assert watch.report()["overflow_constraints"] == 0


def test_buffers_that_suffice_tell_nothing():
    simulation = boxes(njmax=50)
    simulation.data.qpos[:, 2] = 0.09
    watch = OverflowWatch(simulation)
    simulation.step()
    watch.look()
    assert watch.report() == {"overflow_contacts": 0, "overflow_constraints": 0}
