"""Robot in C MuJoCo, in this process: as fast as it goes, or paced to the wall clock."""

import time

import mujoco
import numpy as np

from renet.bundle.manifest import RobotSpec
from renet.deploy.robots.base import JointCommand, RobotState
from renet.deploy.robots.sim.servos import make_servos
from renet.errors import RenetError
from renet.interface import JOINTS, TRUNK
from renet.motor_models import MotorModel
from renet.robots import find_robot
from renet.robots.model import joint_addresses, trunk_addresses

SEEN_GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)
"""MuJoCo geom groups of the terrain; robots' collision geoms are in group 3."""
UNSEEN_GROUP = 5
"""MuJoCo geom group that no camera sees."""
UNSTABLE = tuple(getattr(mujoco.mjtWarning, f"mjWARN_BADQ{of}") for of in ("POS", "VEL", "ACC"))
"""MuJoCo's warnings of values that are not finite or beyond all measure."""
ANY_DISTANCE = mujoco.mjMAXVAL
"""No cutoff: MuJoCo would drop planes whose origin is farther away than the cutoff."""


class MujocoRobot:
    """Simulated robot, whose clock is the simulation's."""

    def __init__(
        self,
        model: mujoco.MjModel,
        robot: RobotSpec,
        ground: float = 0.0,
        real_time: bool = False,
        motors: MotorModel | None = None,
    ) -> None:
        """Put the robot of a scene (see scene.build_scene) at the origin, in its default pose.

        Args:
            model: Scene; motors that are not ideal change it.
            robot: Robot of the bundle.
            ground: Height of the ground at the origin, m.
            real_time: Pace the simulation to the wall clock.
            motors: Motors of the joints, which step with the physics; ideal by default.
        """
        self.description = find_robot(robot.name)
        self.model = model
        self.data = place(model, ground + self.description.height)
        self._real_time = real_time
        self._servos = make_servos(model, self.data, motors)
        self._position, self._velocity = joint_addresses(model)
        self._base, self._motion = trunk_addresses(model)
        self.data.qpos[self._position] = robot.default_position
        # Joints are limp until the first command.
        limp = np.zeros(len(JOINTS))
        self.write(JointCommand(np.array(robot.default_position), limp, limp))
        mujoco.mj_forward(model, self.data)
        self._begun = 0.0
        self._hidden: list[int] = []

    def connect(self) -> None:
        """Start the wall clock."""
        self._begun = time.monotonic() - self.data.time

    def read(self) -> RobotState:
        """Return the newest reading, without waiting."""
        data = self.data
        return RobotState(
            time=data.time,
            joint_position=data.qpos[self._position],
            joint_velocity=data.qvel[self._velocity],
            joint_torque=data.actuator_force[self._servos.ids],
            quaternion=data.qpos[self._base][3:].copy(),
            angular_velocity=data.qvel[self._motion][3:].copy(),
        )

    def write(self, command: JointCommand) -> None:
        """Hand a command to the servos."""
        self._servos.write(command)

    def now(self) -> float:
        """Return the simulated time, s."""
        return self.data.time

    def wait(self, until: float) -> None:
        """Simulate until a time, and sleep in real time; raises RenetError if physics fail."""
        timestep = self.model.opt.timestep
        for _ in range(round((until - self.data.time) / timestep)):
            self._servos.step()
            mujoco.mj_step(self.model, self.data)
            check_physics(self.model, self.data)
        # Readings are taken between steps: positions and derived poses must agree.
        mujoco.mj_forward(self.model, self.data)
        if self._real_time:
            time.sleep(max(0.0, self._begun + self.data.time - time.monotonic()))

    def close(self) -> None:
        """Do nothing: there is nothing to let go of."""

    # What follows is for scores and the simulated camera: a real robot does not know it.

    @property
    def base_position(self) -> np.ndarray:
        """[3] position of the base in the world, m."""
        return self.data.qpos[self._base][:3].copy()

    @property
    def base_rotation(self) -> np.ndarray:
        """[3, 3] rotation from base to world."""
        return self.data.body(TRUNK).xmat.reshape(3, 3)

    def hide(self, geoms: list[int]) -> None:
        """Let rays pass through these geoms of the terrain, and through no others."""
        self._hidden = geoms

    def cast(self, eye: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Cast rays from `eye`, [3] m, along unit vectors [R, 3], in the world frame.

        Returns:
            Distances to the terrain, [R] m; inf where there is none.
        """
        model = self.model
        hidden = self._hidden
        count = len(directions)
        distance = np.empty(count)
        geoms = np.empty(count, np.int32)
        # MuJoCo hides geoms from rays by their groups alone.
        groups = model.geom_group[hidden]
        model.geom_group[hidden] = UNSEEN_GROUP
        rays = np.ascontiguousarray(directions).ravel()
        hits = (geoms, distance, None, count, ANY_DISTANCE)
        mujoco.mj_multiRay(model, self.data, eye, rays, SEEN_GROUPS, True, -1, *hits)
        model.geom_group[hidden] = groups
        return np.where(geoms >= 0, distance, np.inf)


def place(model: mujoco.MjModel, height: float) -> mujoco.MjData:
    """Make a simulation at its start, with the trunk level at x = y = 0 and at `height`, m."""
    # If MuJoCo started an unstable simulation anew by itself, its clock would jump back.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    data = mujoco.MjData(model)
    base, _ = trunk_addresses(model)
    data.qpos[base] = (0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0)
    return data


def check_physics(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Raise RenetError once the simulation has become unstable."""
    for kind in UNSTABLE:
        if data.warning[kind].number:
            raise RenetError(
                f"the simulation became unstable at {data.time:.2f} s (MuJoCo: "
                f"{kind.name.removeprefix('mjWARN_')}): is the scene's physics possible?"
            )
