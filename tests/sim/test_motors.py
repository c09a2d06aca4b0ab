"""Late targets and torque–speed curves, stepped both ways, against MuJoCo and hand numbers."""

import mujoco
import numpy as np
import pytest
import torch
from tests.sim.scenes import scene, simulate

from renet.sim.motors import Motors, torque_share
from renet.sim.native.engine import NativeSimulation

SUBSTEPS = 4
ARM = """<body pos="0 0 1"><joint name="{0}" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass=".5"/></body>"""
SERVO = '<position joint="{0}" kp="20" kv="0.5" forcerange="-10 10"/>'
# The second joint's servo comes first: actuators are not in the joints' order.
MODEL = scene(
    ARM.format("a"),
    ARM.format("b"),
    extra=f"<actuator>{SERVO.format('b')}{SERVO.format('a')}</actuator>",
)


def driven(fused: bool, **options) -> tuple[NativeSimulation, Motors]:
    """Three robots with motors, which the engine drives itself, or not."""
    sim = simulate(MODEL)
    sim.expand_model_fields(("actuator_forcerange",))
    motors = Motors(MODEL, 3, substeps=SUBSTEPS, **options)
    if fused:
        sim.use_motors(motors)
    return sim, motors


def control(sim: NativeSimulation, motors: Motors, fused: bool, target: torch.Tensor) -> None:
    """A control step, as mjlab takes it: targets are written before every call of the engine."""
    if fused:
        sim.data.ctrl[:] = target
        sim.step_n(SUBSTEPS)
        return
    for _ in range(SUBSTEPS):
        sim.data.ctrl[:] = target
        motors.drive(sim)
        sim.step()


TARGETS = torch.tensor([[0.5, -0.25], [-0.5, 0.75], [0.25, 0.5], [1.0, -1.0], [0.0, 0.25]])
"""One for each control step: b, a."""
LAGS = torch.tensor([[0, 1], [3, 4], [5, 9]])
"""Physics steps by which each robot's targets are late."""


def late(lag: np.ndarray) -> np.ndarray:
    """Joint positions and velocities after every control step in C MuJoCo, one target a time."""
    model = MODEL.__copy__()
    model.opt.timestep = 0.005
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    states = []
    for step in range(SUBSTEPS * len(TARGETS)):
        for actuator in range(2):
            issued = max((step - int(lag[actuator])) // SUBSTEPS, 0)
            data.ctrl[actuator] = TARGETS[issued, actuator]
        mujoco.mj_step(model, data)
        if (step + 1) % SUBSTEPS == 0:
            states.append(np.concatenate([data.qpos, data.qvel]))
    return np.array(states)


@pytest.mark.parametrize("fused", [True, False])
def test_targets_arrive_late_as_set(fused):
    sim, motors = driven(fused, max_lag=9)
    motors.lag[:] = LAGS
    walked = []
    for target in TARGETS:
        control(sim, motors, fused, target.repeat(3, 1))
        walked.append(torch.cat([sim.data.qpos[:], sim.data.qvel[:]], dim=1).clone())
    for robot in range(3):
        found = torch.stack(walked)[:, robot].numpy()
        np.testing.assert_allclose(found, late(LAGS[robot].numpy()), rtol=1e-4, atol=1e-5)
    assert np.abs(late(LAGS[0].numpy()) - late(LAGS[1].numpy())).max() > 0.1


@pytest.mark.parametrize("fused", [True, False])
def test_first_target_fills_the_past(fused):
    sim, motors = driven(fused, max_lag=4)
    motors.lag[:] = 4
    control(sim, motors, fused, torch.ones(3, 2))
    sim.reset(torch.tensor([1]))
    motors.reset(torch.tensor([1]))
    sim.forward()
    control(sim, motors, fused, -torch.ones(3, 2))
    position = sim.data.qpos[:]
    assert (position[[0, 2]] > 0.0).all(), "they still follow the target before"
    assert (position[1] < 0.0).all()


@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize(
    ("speed", "target", "torque"),
    [
        (0.0, 9.0, 10.0),
        (5.0, 9.0, 7.5),  # A quarter of the no-load speed of 20 rad/s.
        (5.0, -9.0, -10.0),  # Braking.
        (-15.0, -9.0, -2.5),
        (25.0, 9.0, 0.0),
        (25.0, -9.0, -10.0),
    ],
)
def test_torque_falls_to_no_load_speed(fused, speed, target, torque):
    sim, motors = driven(fused, falls_with_speed=True)
    motors.no_load_speed[:] = torch.tensor([20.0, 1e9])
    sim.data.qvel[:] = speed
    sim.data.ctrl[:] = target
    if not fused:
        motors.drive(sim)
    sim.step()
    force = sim.data.actuator_force[:]
    torch.testing.assert_close(force[:, 0], torch.full((3,), torque))
    # The other motor's is the limit, or what the servo asks for.
    assert force[:, 1].abs() == pytest.approx(10.0, abs=1e-4)


def test_own_limit_is_torque_at_rest():
    sim, motors = driven(True, falls_with_speed=True)
    motors.no_load_speed[:] = 20.0
    limits = torch.tensor([[-8.0, 8.0], [-10.0, 10.0], [-12.0, 12.0]])[:, None].expand(3, 2, 2)
    sim.model.actuator_forcerange[:] = limits
    sim.data.qvel[:] = 10.0
    sim.data.ctrl[:] = 9.0
    sim.step_n(1)
    force = sim.data.actuator_force[:, 0]
    torch.testing.assert_close(force, torch.tensor([4.0, 5.0, 6.0]))
    torch.testing.assert_close(sim.model.actuator_forcerange[:], limits)


def test_without_delay_and_curve_motors_change_nothing():
    plain = simulate(MODEL)
    sim, _ = driven(True, max_lag=4, falls_with_speed=True)
    for target in TARGETS:
        for simulation in (plain, sim):
            simulation.data.ctrl[:] = target
            simulation.step_n(SUBSTEPS)
    assert torch.equal(plain.data.qpos[:], sim.data.qpos[:])


def test_the_share_of_torque_is_within_one():
    speeds = torch.tensor([-30.0, 0.0, 15.0, 30.0, 45.0])
    share = torque_share(speeds, torch.tensor(30.0))
    torch.testing.assert_close(share, torch.tensor([1.0, 1.0, 0.5, 0.0, 0.0]))
