"""A driver of one's own: `python examples/pybullet_driver.py deploy --robot pybullet`.

It runs any bundle in PyBullet (`pip install pybullet==3.2.7`), which shares no code with MuJoCo:
contacts, friction and integration are its own, and so are the rays of its depth camera. The robot
(masses, inertias, joints, collision geoms) and the terrain are read from the compiled MuJoCo scene,
so that both engines simulate the same things.
"""

import time
from dataclasses import dataclass

import mujoco
import numpy as np
import pybullet
from pybullet_utils.bullet_client import BulletClient

from renet.bundle.manifest import RobotSpec
from renet.cli import main
from renet.deploy.catalogue import ROBOTS, SimulationCfg
from renet.deploy.robots.base import JointCommand, RobotState
from renet.errors import RenetError
from renet.interface import JOINTS, TRUNK
from renet.motor_models import IDEAL
from renet.robots import find_robot

SERVO_DT = 0.001
"""s of a physics step, in which the servos' torque is constant; a Go1's motors are as quick."""
ROBOT, TERRAIN = 1, 2
"""Collision groups: the robot touches the terrain only, as in MuJoCo."""
FRICTION = 1.0
"""Of both; Bullet multiplies them."""
MAX_RAY = 100.0
"""m"""
STILL = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0}
"""Bullet brakes bodies and joints by default."""


class BulletRobot:
    """A simulated robot; its clock is the simulation's."""

    def __init__(
        self, model: mujoco.MjModel, robot: RobotSpec, ground: float = 0.0, real_time: bool = False
    ) -> None:
        """Put the robot at the origin, in its default pose.

        Args:
            model: a compiled scene with the robot in it (see scene.build_scene).
            robot: of the bundle. ground: height of what it stands on, m.
            real_time: pace the simulation to the wall clock.

        Raises:
            RenetError: the scene has a geom that PyBullet lacks, such as a height field.
        """
        self.description = find_robot(robot.name)
        self.model = model
        self._real_time, self._begun = real_time, 0.0
        self._engine = engine = BulletClient(pybullet.DIRECT)
        engine.setGravity(*model.opt.gravity)
        engine.setPhysicsEngineParameter(fixedTimeStep=SERVO_DT)
        self._trunk = model.body(TRUNK).id
        self._add_terrain()
        self._body, links = self._add_robot()
        self._links = [links[name] for name in JOINTS]
        for link, angle in zip(self._links, robot.default_position, strict=True):
            engine.resetJointState(self._body, link, angle)
        height = np.array([0.0, 0.0, ground + self.description.height])
        engine.resetBasePositionAndOrientation(
            self._body, height + model.body_ipos[self._trunk], _xyzw(model.body_iquat[self._trunk])
        )
        # Without this Bullet's own motors brake every joint.
        engine.setJointMotorControlArray(
            self._body, self._links, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(JOINTS)
        )
        limp = np.zeros(len(JOINTS))
        self._command = JointCommand(np.array(robot.default_position), limp, limp)
        self._torque, self._steps = limp, 0

    def connect(self) -> None:
        """Start the wall clock."""
        self._begun = time.monotonic() - self.now()

    def read(self) -> RobotState:
        """Newest reading, without waiting."""
        rotation = self._base()[1]
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation.ravel())
        _, spin = self._engine.getBaseVelocity(self._body)
        position, velocity = self._joints()
        return RobotState(
            time=self.now(),
            joint_position=position,
            joint_velocity=velocity,
            joint_torque=self._torque,
            quaternion=quaternion,
            angular_velocity=rotation.T @ np.array(spin),
        )

    def write(self, command: JointCommand) -> None:
        """Hand a command to the servos."""
        self._command = command

    def now(self) -> float:
        """Simulated seconds."""
        return self._steps * SERVO_DT

    def wait(self, until: float) -> None:
        """Simulate, and in real time sleep."""
        while self.now() < until - 0.5 * SERVO_DT:
            position, velocity = self._joints()
            command, limit = self._command, self.description.torque
            torque = command.stiffness * (command.position - position) - command.damping * velocity
            self._torque = np.clip(torque, -limit, limit)
            self._engine.setJointMotorControlArray(
                self._body, self._links, pybullet.TORQUE_CONTROL, forces=self._torque
            )
            self._engine.stepSimulation()
            self._steps += 1
        if self._real_time:
            time.sleep(max(0.0, self._begun + self.now() - time.monotonic()))

    def close(self) -> None:
        """Let go of the engine."""
        if self._engine.isConnected():
            self._engine.disconnect()

    # For scores and the simulated camera, not for the controller: a robot does not know these.

    @property
    def base_position(self) -> np.ndarray:
        """[3] m, world."""
        return self._base()[0]

    @property
    def base_rotation(self) -> np.ndarray:
        """[3, 3], base to world."""
        return self._base()[1]

    def hide(self, geoms: list[int]) -> None:
        """Glass is MuJoCo's alone."""
        if geoms:
            raise RenetError("--fault glass needs --robot mujoco")

    def cast(self, eye: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Distance in m to the terrain along unit directions [R, 3]; infinite without any."""
        ends = eye + MAX_RAY * directions
        starts = np.broadcast_to(eye, ends.shape)
        hits = self._engine.rayTestBatch(starts, ends, collisionFilterMask=TERRAIN)
        body, share = np.array([(body, share) for body, _, share, _, _ in hits]).T
        return np.where(body >= 0, MAX_RAY * share, np.inf)

    def _joints(self) -> tuple[np.ndarray, np.ndarray]:
        states = self._engine.getJointStates(self._body, self._links)
        return np.array([s[0] for s in states]), np.array([s[1] for s in states])

    def _base(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [3] and rotation [3, 3] of the base; Bullet tells its inertial frame's."""
        position, quaternion = self._engine.getBasePositionAndOrientation(self._body)
        inertial = np.reshape(pybullet.getMatrixFromQuaternion(quaternion), (3, 3))
        turned = np.empty(9)
        mujoco.mju_quat2Mat(turned, self.model.body_iquat[self._trunk])
        rotation = inertial @ turned.reshape(3, 3).T
        return np.array(position) - rotation @ self.model.body_ipos[self._trunk], rotation

    def _add_terrain(self) -> None:
        """One fixed body for each geom of the world."""
        model, engine, data = self.model, self._engine, mujoco.MjData(self.model)
        mujoco.mj_kinematics(model, data)
        quaternion = np.empty(4)
        for geom in np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0).tolist():
            mujoco.mju_mat2Quat(quaternion, data.geom_xmat[geom])
            body = engine.createMultiBody(
                baseCollisionShapeIndex=engine.createCollisionShape(**_shape(model, geom)),
                basePosition=data.geom_xpos[geom],
                baseOrientation=_xyzw(quaternion),
            )
            engine.changeDynamics(body, -1, lateralFriction=FRICTION)
            engine.setCollisionFilterGroupMask(body, -1, TERRAIN, ROBOT)

    def _add_robot(self) -> tuple[int, dict[str, int]]:
        """The body, and its links by their joint's name."""
        model, engine = self.model, self._engine
        bodies = np.flatnonzero(model.body_rootid == self._trunk)
        links = [int(body) for body in bodies if body != self._trunk]
        joints = [int(model.body_jntadr[body]) for body in links]
        index = {self._trunk: 0} | {body: n + 1 for n, body in enumerate(links)}
        base = self._trunk
        made = engine.createMultiBody(
            baseMass=model.body_mass[base],
            baseCollisionShapeIndex=self._compound(base),
            baseInertialFramePosition=model.body_ipos[base],
            baseInertialFrameOrientation=_xyzw(model.body_iquat[base]),
            linkMasses=model.body_mass[links],
            linkCollisionShapeIndices=[self._compound(body) for body in links],
            linkVisualShapeIndices=[-1] * len(links),
            linkPositions=model.body_pos[links],
            linkOrientations=[_xyzw(model.body_quat[body]) for body in links],
            linkInertialFramePositions=model.body_ipos[links],
            linkInertialFrameOrientations=[_xyzw(model.body_iquat[body]) for body in links],
            linkParentIndices=[index[int(model.body_parentid[body])] for body in links],
            linkJointTypes=[pybullet.JOINT_REVOLUTE] * len(links),
            linkJointAxis=model.jnt_axis[joints],
        )
        engine.changeDynamics(made, -1, localInertiaDiagonal=model.body_inertia[base], **STILL)
        engine.setCollisionFilterGroupMask(made, -1, ROBOT, TERRAIN)
        for link, (body, joint) in enumerate(zip(links, joints, strict=True)):
            low, high = model.jnt_range[joint]
            engine.changeDynamics(
                made,
                link,
                localInertiaDiagonal=model.body_inertia[body],
                jointLowerLimit=low,
                jointUpperLimit=high,
                lateralFriction=FRICTION,
                **STILL,
            )
            engine.setCollisionFilterGroupMask(made, link, ROBOT, TERRAIN)
        return made, {model.joint(joint).name: link for link, joint in enumerate(joints)}

    def _compound(self, body: int) -> int:
        """One collision shape of all of a body's geoms."""
        model = self.model
        first = model.body_geomadr[body]
        geoms = range(first, first + model.body_geomnum[body])
        shapes = [_shape(model, geom) for geom in geoms]
        return self._engine.createCollisionShapeArray(
            shapeTypes=[shape["shapeType"] for shape in shapes],
            radii=[shape.get("radius", 0.0) for shape in shapes],
            halfExtents=[shape.get("halfExtents", (0.0, 0.0, 0.0)) for shape in shapes],
            lengths=[shape.get("height", 0.0) for shape in shapes],
            collisionFramePositions=[model.geom_pos[geom] for geom in geoms],
            collisionFrameOrientations=[_xyzw(model.geom_quat[geom]) for geom in geoms],
        )


def _shape(model: mujoco.MjModel, geom: int) -> dict:
    """A MuJoCo geom in PyBullet's words; MuJoCo gives half of what Bullet calls height."""
    size, kind = model.geom_size[geom], mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        return {"shapeType": pybullet.GEOM_PLANE, "planeNormal": (0.0, 0.0, 1.0)}
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return {"shapeType": pybullet.GEOM_BOX, "halfExtents": size}
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return {"shapeType": pybullet.GEOM_SPHERE, "radius": size[0]}
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return {"shapeType": pybullet.GEOM_CAPSULE, "radius": size[0], "height": 2.0 * size[1]}
    raise RenetError(f"--robot pybullet has no {kind.name[7:].lower()}: choose another --terrain")


def _xyzw(quaternion: np.ndarray) -> np.ndarray:
    """Bullet's order of a quaternion (w, x, y, z)."""
    return np.roll(quaternion, -1)


@dataclass(frozen=True)
class PybulletCfg(SimulationCfg):
    """The bundle's robot in PyBullet, in this process, with the options of MuJoCo's."""

    def check(self) -> None:
        """Raise RenetError for options that cannot work."""
        super().check()
        if self.viewer:
            raise RenetError("--viewer shows MuJoCo's simulation: use --robot mujoco")
        if self.motors != IDEAL:
            raise RenetError("--motors are those of MuJoCo's simulation: use --robot mujoco")

    def engine(self) -> type[BulletRobot]:
        """The class of the simulated robot."""
        return BulletRobot


ROBOTS["pybullet"] = PybulletCfg

if __name__ == "__main__":
    raise SystemExit(main())
