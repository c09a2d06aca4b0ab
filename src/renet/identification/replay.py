"""Replay of a log's joint targets on a simulated robot whose trunk is fixed in the air."""

import math
import os
from collections.abc import Sequence
from copy import copy

import mujoco
import numpy as np
from mujoco import rollout

from renet.identification.motion_log import MotionLog
from renet.interface import JOINTS, TRUNK
from renet.motors import LARGEST, PARAMETERS
from renet.robots import Robot
from renet.robots.model import joint_addresses, servo_ids, simulation_model

ARMATURE, DAMPING, FRICTION, DELAY = range(len(PARAMETERS))
"""Columns of a table of motors [12, 4]: `motors.PARAMETERS` of each of `interface.JOINTS`."""
CHUNK_STEPS = 10_000
"""Number of physics steps whose states are in memory at the same time."""


class SuspendedRobot:
    """Robot in MuJoCo whose trunk is fixed and level, and whose legs touch nothing.

    The servos have the log's Kp and Kd, and saturate at the torques of the robot's description.
    """

    def __init__(self, description: Robot, log: MotionLog, timestep: float) -> None:
        """Compile the robot for the gains and the rate of a log.

        Args:
            description: The robot.
            log: Log with the targets to replay.
            timestep: Longest physics step, s. A row of the log is a whole number of steps.
        """
        self._log = log
        self._substeps = max(1, math.ceil(log.period / timestep - 1e-9))
        self._timestep = log.period / self._substeps
        self._model = _compile(description, log, self._timestep)
        self._position, self._dof = joint_addresses(self._model)
        self._servo = servo_ids(self._model)
        self.lower, self.upper = np.array([self._model.joint(name).range for name in JOINTS]).T
        """Lower and upper limits of the joints, [12] rad each."""
        # Integrals of the targets over time. Shifted in time, they give delayed targets.
        sums = np.cumsum(log.target, axis=0) * log.period
        before = -LARGEST.delay * log.target[:1]
        self._integral = np.concatenate([before, np.zeros((1, len(JOINTS))), sums])
        self._times = np.concatenate([[-LARGEST.delay], np.arange(len(log) + 1) * log.period])

    @property
    def described_motors(self) -> np.ndarray:
        """Motors of the robot's MJCF, which have no delay, [12, 4]."""
        columns = (
            self._model.dof_armature[self._dof],
            self._model.dof_damping[self._dof],
            self._model.dof_frictionloss[self._dof],
            np.zeros(len(JOINTS)),
        )
        return np.stack(columns, axis=1)

    def replay(self, motors: Sequence[np.ndarray], rows: range) -> np.ndarray:
        """Replay some of the log's rows with each of N sets of motors, on all cores.

        Args:
            motors: N tables of motors, [12, 4] each.
            rows: Rows of the log. Joints start with the measured state of the first one.

        Returns:
            Joint positions, [N, len(rows), 12] rad.
        """
        log = self._log
        count = len(motors)
        models = [self._with_motors(table) for table in motors]
        threads = min(count, len(os.sched_getaffinity(0)))
        data = [mujoco.MjData(self._model) for _ in range(threads)]
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        # MuJoCo's order: time, positions, velocities.
        position = 1 + self._position
        velocity = 1 + self._model.nq + self._dof
        state = np.zeros((count, mujoco.mj_stateSize(self._model, kind)))
        state[:, position] = log.position[rows.start]
        state[:, velocity] = log.velocity[rows.start]
        replayed = [state[:, None, position]]
        chunk = max(1, CHUNK_STEPS // self._substeps)
        for start in range(rows.start, rows.stop - 1, chunk):
            stop = min(start + chunk, rows.stop - 1)
            control = np.zeros((count, (stop - start) * self._substeps, self._model.nu))
            for number, table in enumerate(motors):
                control[number][:, self._servo] = self._delayed(start, stop, table[:, DELAY])
            states = np.asarray(rollout.rollout(models, data, state, control)[0])
            replayed.append(states[:, self._substeps - 1 :: self._substeps, position])
            state = states[:, -1]
        return np.concatenate(replayed, axis=1)

    def _with_motors(self, table: np.ndarray) -> mujoco.MjModel:
        """Copy the model with other motors, [12, 4]."""
        model = copy(self._model)
        model.dof_armature[self._dof] = table[:, ARMATURE]
        model.dof_damping[self._dof] = table[:, DAMPING]
        model.dof_frictionloss[self._dof] = table[:, FRICTION]
        return model

    def _delayed(self, start: int, stop: int, delay: np.ndarray) -> np.ndarray:
        """Compute the mean delayed target in each physics step of rows `start` to `stop`.

        A mean varies smoothly with the delay, which need not be a whole number of steps.

        Args:
            start: First row.
            stop: Row after the last one.
            delay: Delay of each joint, [12] s.

        Returns:
            Targets, [steps, 12] rad.
        """
        steps = np.arange((stop - start) * self._substeps + 1) * self._timestep
        edges = start * self._log.period + steps
        integrals = []
        for seconds, integral in zip(delay, self._integral.T, strict=True):
            integrals.append(np.interp(edges - seconds, self._times, integral))
        means = np.diff(np.array(integrals, float)) / self._timestep
        return means.T


def _compile(description: Robot, log: MotionLog, timestep: float) -> mujoco.MjModel:
    """Compile the robot alone, with its trunk fixed to the world and the servos of the log."""
    spec = simulation_model(description)
    for joint in list(spec.body(TRUNK).joints):
        spec.delete(joint)
    for geom in spec.geoms:
        geom.contype = 0
        geom.conaffinity = 0
    spec.option.timestep = timestep
    for name, stiffness, damping in zip(JOINTS, log.stiffness, log.damping, strict=True):
        servo = spec.actuator(name)
        servo.gainprm[0] = stiffness
        servo.biasprm[1] = -stiffness
        servo.biasprm[2] = -damping
    return spec.compile()
