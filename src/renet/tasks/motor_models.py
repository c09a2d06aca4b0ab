"""Motors of a task in place of MuJoCo's servos: measured ones, or a network of real ones."""

import re
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import mujoco_warp as mjwarp
import torch
from mjlab.actuator import BuiltinPositionActuatorCfg, IdealPdActuator, IdealPdActuatorCfg
from mjlab.actuator.actuator import ActuatorCfg, ActuatorCmd
from mjlab.entity import Entity, EntityCfg
from torch import Tensor

from renet.errors import RenetError
from renet.interface import JOINTS
from renet.motor_models import MotorModel
from renet.motor_models.network import SAMPLES, MotorNetwork
from renet.motors import MotorFit
from renet.tasks.motors import MotorsCfg


@dataclass(kw_only=True)
class NetworkActuatorCfg(IdealPdActuatorCfg):
    """Motors whose torque a network predicts at every physics step."""

    network: MotorNetwork
    """The network, with NumPy arrays."""

    def build(
        self, entity: Entity, target_ids: list[int], target_names: list[str]
    ) -> "NetworkActuator":
        """Build the motors of some joints."""
        return NetworkActuator(self, entity, target_ids, target_names)


class NetworkActuator(IdealPdActuator[NetworkActuatorCfg]):
    """Torque motors driven by a network, whose gains and limits are randomised like a servo's."""

    def initialize(
        self, mj_model: mujoco.MjModel, model: mjwarp.Model, data: mjwarp.Data, device: str
    ) -> None:
        """Allocate the samples of all robots; mjlab calls this after it compiled the model."""
        super().initialize(mj_model, model, data, device)
        self._network = self.cfg.network.converted(lambda array: torch.tensor(array, device=device))
        shape = (data.nworld, len(self.target_names), SAMPLES)
        # The network's inputs, newest first: [N, J, SAMPLES].
        self._errors = torch.zeros(shape, device=device)
        self._velocities = torch.zeros(shape, device=device)
        # The inputs after the next physics step.
        self._next_errors = self._errors
        self._next_velocities = self._velocities

    def compute(self, cmd: ActuatorCmd) -> Tensor:
        """Compute torques, [N, J] N m. `update` keeps the samples once the step is taken."""
        network = self._network
        assert self.stiffness is not None
        assert self.damping is not None
        assert self.force_limit is not None
        error = network.scale_error(cmd.pos - cmd.position_target, self.stiffness)
        velocity = network.scale_velocity(cmd.vel, self.damping)
        self._next_errors = _push(self._errors, error)
        self._next_velocities = _push(self._velocities, velocity)
        torque = network.torque(self._next_errors, self._next_velocities)
        return torque.clamp(-self.force_limit, self.force_limit)

    def update(self, dt: float) -> None:
        """Keep the samples of the physics step that was taken."""
        self._errors = self._next_errors
        self._velocities = self._next_velocities

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """Set the samples of some robots to zero; None means all robots."""
        super().reset(env_ids)
        rows = slice(None) if env_ids is None else env_ids
        self._errors[rows] = 0.0
        self._velocities[rows] = 0.0

    def copy_rows(self, source: Tensor) -> None:
        """Copy gains and limits from the robots `source`, [N], one for each robot."""
        for values in (self.stiffness, self.damping, self.force_limit):
            assert values is not None
            values[:] = values[source]


def _push(samples: Tensor, newest: Tensor) -> Tensor:
    """Put a new sample [N, J] in front of samples [N, J, S], and drop the oldest."""
    return torch.cat((newest.unsqueeze(-1), samples[..., :-1]), dim=-1)


def use_motors(robot: EntityCfg, cfg: MotorsCfg, motors: MotorModel | None) -> None:
    """Replace the motors of a robot, in place.

    Delays of the actuators stay; those of measured motors are added.

    Args:
        robot: The robot of a task.
        cfg: The task's motors, to which delays are added.
        motors: Measured motors or a network; None changes nothing.

    Raises:
        RenetError: The task has delays or torque–speed curves, which a network contains already.
    """
    if motors is None:
        return
    articulation = robot.articulation
    assert articulation is not None
    if isinstance(motors, MotorFit):
        servos = [_measured_servo(articulation.actuators, joint, motors) for joint in JOINTS]
        articulation.actuators = tuple(servos)
        delay = motors.array("delay").tolist()
        cfg.joint_delay = dict(zip(JOINTS, delay, strict=True))
    else:
        if not cfg.ideal:
            raise RenetError("a network of motors takes neither delays nor torque–speed curves")
        networks = []
        for servo in articulation.actuators:
            networks.append(NetworkActuatorCfg(network=motors, **_servo_fields(servo)))
        articulation.actuators = tuple(networks)


def _measured_servo(
    actuators: tuple[ActuatorCfg, ...], joint: str, fit: MotorFit
) -> BuiltinPositionActuatorCfg:
    """Return the servo of a joint, of a robot's actuators, with measured inertia and friction."""
    servo = _servo_of(actuators, joint)
    motor = fit.of(joint)
    return replace(
        servo,
        target_names_expr=(joint,),
        armature=motor.armature,
        viscous_damping=motor.damping,
        frictionloss=motor.friction,
    )


def _servo_of(actuators: tuple[ActuatorCfg, ...], joint: str) -> BuiltinPositionActuatorCfg:
    """Find the servo of a joint by the patterns of its joints' names."""
    for servo in actuators:
        if any(re.fullmatch(pattern, joint) for pattern in servo.target_names_expr):
            assert isinstance(servo, BuiltinPositionActuatorCfg)
            return servo
    raise AssertionError(f"no actuator drives {joint}")


def _servo_fields(servo: ActuatorCfg) -> dict[str, Any]:
    """Return the fields of a servo that torque motors have, too."""
    assert isinstance(servo, BuiltinPositionActuatorCfg)
    return {name: value for name, value in vars(servo).items() if value is not None}
