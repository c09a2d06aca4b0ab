"""Joint servos of a robot in C MuJoCo: ideal, measured, or a network of real motors."""

from collections import deque

import mujoco
import numpy as np

from renet.deploy.robots.base import JointCommand
from renet.errors import RenetError
from renet.interface import JOINTS, PHYSICS_DT
from renet.motor_models import MotorModel
from renet.motor_models.network import SAMPLES, MotorNetwork
from renet.motors import MotorFit
from renet.robots.model import joint_addresses, servo_ids


class Servos:
    """MuJoCo's own servos, which obey at once, with the limits of the motors' torque."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Take the servos of a scene, each named as the joint that it drives."""
        self.model = model
        self.data = data
        self.ids = servo_ids(model)
        """Numbers of the servos in the order of `interface.JOINTS`."""

    def write(self, command: JointCommand) -> None:
        """Hand a command over, which holds until the next."""
        model = self.model
        servos = self.ids
        self.data.ctrl[servos] = command.position
        model.actuator_gainprm[servos, 0] = command.stiffness
        model.actuator_biasprm[servos, 1] = -command.stiffness
        model.actuator_biasprm[servos, 2] = -command.damping

    def step(self) -> None:
        """Do what is due before a physics step: nothing."""


class MeasuredServos(Servos):
    """Servos with measured motors: inertia and friction in the joints, and a delay."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, fit: MotorFit) -> None:
        """Change the joints of a scene's model into the measured ones."""
        super().__init__(model, data)
        _, dofs = joint_addresses(model)
        model.dof_armature[dofs] = fit.array("armature")
        model.dof_damping[dofs] = fit.array("damping")
        model.dof_frictionloss[dofs] = fit.array("friction")
        # MuJoCo derives other constants of the model from these.
        mujoco.mj_setConst(model, mujoco.MjData(model))
        self._lag = np.round(fit.array("delay") / model.opt.timestep).astype(int)
        self._newest: JointCommand | None = None
        self._sent: deque[JointCommand] = deque(maxlen=int(self._lag.max()) + 1)
        """The command in force at each of the last physics steps."""

    def write(self, command: JointCommand) -> None:
        """Send a command, which arrives later."""
        self._newest = command

    def step(self) -> None:
        """Let what was sent as long ago as each joint's delay take effect."""
        if self._newest is None:
            return
        self._sent.append(self._newest)
        # Until the first command would arrive, it holds already, since there was none before.
        arrived = [self._sent[-1 - min(lag, len(self._sent) - 1)] for lag in self._lag]
        joints = range(len(JOINTS))
        super().write(
            JointCommand(
                np.array([arrived[joint].position[joint] for joint in joints]),
                np.array([arrived[joint].stiffness[joint] for joint in joints]),
                np.array([arrived[joint].damping[joint] for joint in joints]),
            )
        )


class NetworkServos(Servos):
    """Motors whose torque a network predicts, at its own rate."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, network: MotorNetwork) -> None:
        """Turn a scene's servos into motors that take a torque.

        Raises:
            RenetError: The physics steps have another length than the network's samples.
        """
        super().__init__(model, data)
        if not np.isclose(model.opt.timestep, PHYSICS_DT):
            raise RenetError(
                f"the network of motors needs physics steps of {PHYSICS_DT:g} s, not "
                f"{model.opt.timestep:g} s"
            )
        model.actuator_gainprm[self.ids, 0] = 1.0
        model.actuator_biasprm[self.ids, 1:3] = 0.0
        self._network = network
        self._command: JointCommand | None = None
        self._position, self._velocity = joint_addresses(model)
        # Newest first, as the network takes them.
        self._errors = np.zeros((len(JOINTS), SAMPLES))
        self._velocities = np.zeros((len(JOINTS), SAMPLES))

    def write(self, command: JointCommand) -> None:
        """Hand a command to the network."""
        self._command = command

    def step(self) -> None:
        """Take a sample of every joint, and apply the network's torques."""
        command = self._command
        network = self._network
        if command is None:
            return
        error = self.data.qpos[self._position] - command.position
        velocity = self.data.qvel[self._velocity]
        self._errors = np.roll(self._errors, 1, axis=1)
        self._errors[:, 0] = network.scale_error(error, command.stiffness)
        self._velocities = np.roll(self._velocities, 1, axis=1)
        self._velocities[:, 0] = network.scale_velocity(velocity, command.damping)
        self.data.ctrl[self.ids] = network.torque(self._errors, self._velocities)


def make_servos(
    model: mujoco.MjModel, data: mujoco.MjData, motors: MotorModel | None = None
) -> Servos:
    """Make the servos of a scene; motors are ideal by default."""
    if motors is None:
        return Servos(model, data)
    if isinstance(motors, MotorFit):
        return MeasuredServos(model, data, motors)
    return NetworkServos(model, data, motors)
