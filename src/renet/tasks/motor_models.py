"""Motors that are not MuJoCo's servos in a task: measured ones, and a network of real ones."""

import re
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import mujoco_warp as mjwarp
import torch
from mjlab.actuator import BuiltinPositionActuatorCfg, IdealPdActuator, IdealPdActuatorCfg
from mjlab.actuator.actuator import ActuatorCfg, ActuatorCmd
from mjlab.entity import Entity
from torch import Tensor

from renet.errors import RenetError
from renet.interface import JOINTS
from renet.motor_models import MotorModel
from renet.motor_models.network import SAMPLES, MotorNetwork
from renet.motors import MotorFit
from renet.tasks.env import RenetEnvCfg


@dataclass(kw_only=True)
class NetworkActuatorCfg(IdealPdActuatorCfg):
    """Motors whose torque a network tells, at every physics step."""

    network: MotorNetwork
    """With NumPy arrays."""

    def build(
        self, entity: Entity, target_ids: list[int], target_names: list[str]
    ) -> "NetworkActuator":
        """Make the motors of some joints."""
        return NetworkActuator(self, entity, target_ids, target_names)


class NetworkActuator(IdealPdActuator[NetworkActuatorCfg]):
    """Torque motors driven by a network; gains and limits are randomised as a servo's are."""

    def initialize(
        self, mj_model: mujoco.MjModel, model: mjwarp.Model, data: mjwarp.Data, device: str
    ) -> None:
        """Set up for all robots; mjlab calls it once the model is compiled."""
        super().initialize(mj_model, model, data, device)
        self._network = self.cfg.network.converted(lambda array: torch.tensor(array, device=device))
        shape = (data.nworld, len(self.target_names), SAMPLES)
        # As the network sees them, newest first.
        self._errors = torch.zeros(shape, device=device)
        self._velocities = torch.zeros(shape, device=device)
        self._newest = self._errors, self._velocities

    def compute(self, cmd: ActuatorCmd) -> Tensor:
        """Torques, [N, J] N m. The samples count as taken once the physics step is (`update`)."""
        network = self._network
        assert self.stiffness is not None
        assert self.damping is not None
        assert self.force_limit is not None
        error = network.scale_error(cmd.pos - cmd.position_target, self.stiffness)
        velocity = network.scale_velocity(cmd.vel, self.damping)
        self._newest = _push(self._errors, error), _push(self._velocities, velocity)
        torque = network.torque(*self._newest)
        return torque.clamp(-self.force_limit, self.force_limit)

    def update(self, dt: float) -> None:
        """Keep the samples of the physics step that was taken."""
        self._errors, self._velocities = self._newest

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
        """Forget the samples of some robots."""
        super().reset(env_ids)
        everybody = slice(None) if env_ids is None else env_ids
        self._errors[everybody] = 0.0
        self._velocities[everybody] = 0.0

    def copy_rows(self, source: Tensor) -> None:
        """Give each robot the gains and limits of another; source: [N] its number."""
        for values in (self.stiffness, self.damping, self.force_limit):
            assert values is not None
            values[:] = values[source]


def _push(samples: Tensor, newest: Tensor) -> Tensor:
    """Samples [N, J, S] with a new one [N, J] in front, and without the oldest."""
    return torch.cat((newest.unsqueeze(-1), samples[..., :-1]), dim=-1)


def use_motors(cfg: RenetEnvCfg, motors: MotorModel | None) -> None:
    """Give a task's robot other motors, in place; None leaves those that it has.

    Delays that its actuators already have stay, and those of measured motors are added.
    """
    if motors is None:
        return
    articulation = cfg.scene.entities["robot"].articulation
    assert articulation is not None
    if isinstance(motors, MotorFit):
        articulation.actuators = tuple(
            _measured(articulation.actuators, joint, motors) for joint in JOINTS
        )
        delay = motors.array("delay").tolist()
        cfg.motors.joint_delay = dict(zip(JOINTS, delay, strict=True))
    else:
        if not cfg.motors.ideal:
            raise RenetError("a network of motors takes neither delays nor torque–speed curves")
        articulation.actuators = tuple(
            NetworkActuatorCfg(network=motors, **_shared(servo)) for servo in articulation.actuators
        )


def _measured(
    actuators: tuple[ActuatorCfg, ...], joint: str, fit: MotorFit
) -> BuiltinPositionActuatorCfg:
    """The servo of a joint among a robot's actuators, with measured inertia and friction."""
    servo = next(
        actuator
        for actuator in actuators
        if any(re.fullmatch(pattern, joint) for pattern in actuator.target_names_expr)
    )
    assert isinstance(servo, BuiltinPositionActuatorCfg)
    motor = fit.of(joint)
    return replace(
        servo,
        target_names_expr=(joint,),
        armature=motor.armature,
        viscous_damping=motor.damping,
        frictionloss=motor.friction,
    )


def _shared(servo: ActuatorCfg) -> dict[str, Any]:
    """The fields of a servo that torque motors have, too."""
    assert isinstance(servo, BuiltinPositionActuatorCfg)
    return {name: value for name, value in vars(servo).items() if value is not None}
