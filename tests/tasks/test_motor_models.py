"""Robots of a task with measured motors, and with a network of real ones."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from renet.errors import RenetError
from renet.interface import JOINTS
from renet.motor_models.network import read_network
from renet.motors import MotorFit, MotorParameters
from renet.tasks import env_cfg
from renet.tasks.motor_models import NetworkActuator, use_motors
from renet.tasks.parkour_env_cfg import flat_env_cfg, randomize

NETWORK = read_network()
MOTOR = MotorParameters(armature=0.02, damping=0.3, friction=0.4, delay=0.01)
FIT = MotorFit(
    "Unitree Go1",
    dict.fromkeys(("hip", "thigh", "calf"), MOTOR)
    | {"FL_calf_joint": replace(MOTOR, armature=0.03, delay=0.02)},
)


def task(motors):
    """A flat task whose robots do not fall."""
    cfg = flat_env_cfg(play=True)
    cfg.terminations = {"time_out": cfg.terminations["time_out"]}
    use_motors(cfg.scene.entities["robot"], cfg.motors, motors)
    return cfg


def test_ideal_motors_change_nothing():
    plain, cfg = flat_env_cfg(play=True), flat_env_cfg(play=True)
    use_motors(cfg.scene.entities["robot"], cfg.motors, None)
    assert cfg.scene.entities["robot"].articulation == plain.scene.entities["robot"].articulation
    assert cfg.motors == plain.motors


def test_network_drives_each_physics_step(build):
    """Its torques are what NumPy's network makes of the joints' last three states."""
    env = build(task(NETWORK), 3)
    assert env.physics_dt == pytest.approx(0.005)
    robot = env.scene["robot"]
    seen, found = [], []
    step = env.sim.step

    def watched() -> None:
        error = robot.data.joint_pos - robot.data.joint_pos_target
        seen.append((error.clone(), robot.data.joint_vel.clone()))
        step()
        found.append(env.sim.data.qfrc_actuator[:, 6:].clone())

    env.sim.step = watched
    for action in (0.5, -0.5):
        env.step(torch.full((3, 12), action))
    gains = {name: torch.zeros(3, 12) for name in ("stiffness", "damping", "force_limit")}
    for actuator in robot.actuators:
        for name, values in gains.items():
            values[:, actuator.target_ids] = getattr(actuator, name)
    assert gains["stiffness"].std() > 1.0, "randomised as a servo's"
    for now in range(2, 8):
        errors = [seen[now - age][0] * gains["stiffness"] / 20.0 for age in range(3)]
        velocities = [seen[now - age][1] * gains["damping"] / 0.5 for age in range(3)]
        torque = NETWORK.torque(np.stack(errors, -1), np.stack(velocities, -1))
        limit = gains["force_limit"].numpy()
        np.testing.assert_allclose(found[now], torque.clip(-limit, limit), atol=1e-3)


def test_reset_clears_network_samples(build):
    env = build(task(NETWORK), 2)
    for _ in range(3):
        env.step(torch.ones(2, 12))
    env._reset_idx(torch.tensor([0]))
    env.scene.write_data_to_sim()  # As mjlab does, which is no physics step.
    for actuator in env.scene["robot"].actuators:
        assert (actuator._errors[0] == 0.0).all()
        assert (actuator._velocities[0] == 0.0).all()
        assert (actuator._errors[1] != 0.0).any()


def test_measured_motors_reach_the_model(build):
    env = build(task(FIT), 2)
    model = env.sim.mj_model
    for name in JOINTS:
        joint = model.joint(f"robot/{name}")
        armature = 0.03 if name == "FL_calf_joint" else 0.02
        values = joint.armature, joint.damping, joint.frictionloss
        np.testing.assert_allclose(np.ravel(values), (armature, 0.3, 0.4))
    names = [model.actuator(number).name.split("/")[-1] for number in range(model.nu)]
    lags = dict(zip(names, env.motors.lag[0].tolist(), strict=True))
    assert lags == dict.fromkeys(JOINTS, 2) | {"FL_calf_joint": 4}
    stiffness = env.sim.model.actuator_gainprm[:, :, 0]
    assert stiffness.std(dim=1).min() > 0.5, "randomised as ever"


def test_a_task_names_the_model_of_its_motors(build):
    """Training on a network has an observation of every robot's parameters, as with servos."""
    cfg = env_cfg("Renet-Go1-Flat")
    cfg.motors.model = "go1"
    env = build(cfg, 2)
    assert all(isinstance(actuator, NetworkActuator) for actuator in env.scene["robot"].actuators)
    privileged = env.reset()[0]["privileged"]
    assert privileged.isfinite().all()
    assert (privileged[:, -12:] == 1.0).all()
    # The configuration is the caller's, and can be used again.
    assert cfg.scene.entities["robot"].articulation == (
        env_cfg("Renet-Go1-Flat").scene.entities["robot"].articulation
    )


def test_a_robot_has_no_motors_of_another(build):
    cfg = env_cfg("Renet-Go2-Flat")
    cfg.motors.model = "go1"
    with pytest.raises(RenetError, match="measure its own with `renet identify`"):
        build(cfg, 1)


def test_a_network_refuses_what_it_cannot_delay():
    cfg = flat_env_cfg(play=True)
    randomize(cfg, action_delay=0.02)
    with pytest.raises(RenetError, match="neither delays"):
        use_motors(cfg.scene.entities["robot"], cfg.motors, NETWORK)


def test_delays_of_actuators_stay():
    cfg = flat_env_cfg(play=True)
    for actuator in cfg.scene.entities["robot"].articulation.actuators:
        actuator.delay_min_lag = actuator.delay_max_lag = 4
    use_motors(cfg.scene.entities["robot"], cfg.motors, NETWORK)
    actuators = cfg.scene.entities["robot"].articulation.actuators
    assert {actuator.delay_max_lag for actuator in actuators} == {4}
    assert {actuator.effort_limit for actuator in actuators} == {23.7, 35.55}
