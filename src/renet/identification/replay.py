"""Replays a log's joint targets on a robot whose trunk is held in the air."""

import math
import os
from collections.abc import Sequence
from copy import copy

import mujoco
import numpy as np
from mujoco import rollout

from renet.descriptions import RobotDescription
from renet.identification.motion_log import MotionLog
from renet.interface import JOINTS, TRUNK
from renet.motors import LARGEST, PARAMETERS

ARMATURE, DAMPING, FRICTION, DELAY = range(len(PARAMETERS))
"""Columns of a table of motors [12, 4]: `motors.PARAMETERS` of each of `interface.JOINTS`."""
CHUNK_STEPS = 10_000
"""Physics steps of which the states are in memory at a time."""


class SuspendedRobot:
    """A robot in MuJoCo whose trunk is fixed and level and whose legs touch nothing.

    Each joint's servo is told Kp and Kd, and saturates at the torque of the robot's description.
    """

    def __init__(self, description: RobotDescription, log: MotionLog, timestep: float) -> None:
        """Compile the robot for the gains and the rate of a log.

        Args:
            description: of the robot. log: whose targets are replayed.
            timestep: longest physics step, s; a whole number of them makes a row of the log.
        """
        self._log = log
        self._substeps = max(1, math.ceil(log.period / timestep - 1e-9))
        self._timestep = log.period / self._substeps
        self._model = _compile(description, log, self._timestep)
        joints = [self._model.joint(name) for name in JOINTS]
        self._position = np.array([joint.qposadr[0] for joint in joints])
        self._dof = np.array([joint.dofadr[0] for joint in joints])
        self._servo = np.array([self._model.actuator(name).id for name in JOINTS])
        self.lower, self.upper = np.array([joint.range for joint in joints]).T
        """[12] rad, the joints' limits."""
        # Time integrals of the targets, by time: a shift of these is a delay.
        sums = np.cumsum(log.target, axis=0) * log.period
        before = -LARGEST.delay * log.target[:1]
        self._integral = np.concatenate([before, np.zeros((1, len(JOINTS))), sums])
        self._times = np.concatenate([[-LARGEST.delay], np.arange(len(log) + 1) * log.period])

    @property
    def described_motors(self) -> np.ndarray:
        """Motors of the robot's own MJCF, [12, 4], without a delay."""
        model, dof = self._model, self._dof
        values = (model.dof_armature, model.dof_damping, model.dof_frictionloss)
        return np.stack([*(value[dof] for value in values), np.zeros(len(JOINTS))], axis=1)

    def replay(self, motors: Sequence[np.ndarray], rows: range) -> np.ndarray:
        """Replay some of the log's rows with each of N sets of motors, on all cores.

        Args:
            motors: N tables of motors, [12, 4] each.
            rows: of the log; the joints start as measured in the first one.

        Returns:
            Joint positions [N, len(rows), 12], rad.
        """
        log, count = self._log, len(motors)
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
        """A copy of the model with other motors."""
        model = copy(self._model)
        model.dof_armature[self._dof] = table[:, ARMATURE]
        model.dof_damping[self._dof] = table[:, DAMPING]
        model.dof_frictionloss[self._dof] = table[:, FRICTION]
        return model

    def _delayed(self, start: int, stop: int, delay: np.ndarray) -> np.ndarray:
        """Mean target in each physics step of rows `start` to `stop`, [steps, 12] rad.

        A mean, so that it varies smoothly with the delays [12] s, which need not be whole steps.
        """
        steps = np.arange((stop - start) * self._substeps + 1) * self._timestep
        edges = start * self._log.period + steps
        columns = zip(delay, self._integral.T, strict=True)
        shifted = [np.interp(edges - late, self._times, integral) for late, integral in columns]
        means = np.diff(np.array(shifted, float)) / self._timestep
        return means.T


def _compile(description: RobotDescription, log: MotionLog, timestep: float) -> mujoco.MjModel:
    """The robot alone, its trunk welded to the world, with the servos of the log."""
    spec = mujoco.MjSpec.from_file(str(description.mjcf))
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
