"""A whole deployment, from top to bottom: `python examples/deploy.py --robot mujoco`.

A robot, a depth camera and a pilot, in a loop of 50 Hz. The robot stands up and walks straight
ahead while its camera goes black for a second, then its joints brake. `renet deploy` does the same
and what a robot needs among people: limits, watchdogs, an operator, a recording (docs/deploy.md).
With this file, keep a real robot on a hoist.
"""

import sys
from dataclasses import dataclass
from typing import Literal

import numpy as np
import tyro

import renet
from renet.bundle import Bundle
from renet.bundle.manifest import Manifest
from renet.deploy.cameras.base import Camera
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.catalogue import CAMERAS, ROBOTS
from renet.deploy.observation import observe
from renet.deploy.robots.base import JointCommand, RobotDriver, heading, projected_gravity
from renet.deploy.robots.envelope import clamp
from renet.deploy.steering import STEERINGS
from renet.deploy.teleop.base import Velocity
from renet.errors import RenetError
from renet.faults import parse_fault
from renet.interface import CONTROL_DT

STAND_UP = 2.0
"""Seconds from the pose at the start to the default pose."""
BRAKING = 3.0
"""Damping of braked joints, N m s/rad."""
LEAST_UPRIGHT = 0.34
"""Cosine of the tilt at which the robot is let go, 70 degrees."""


@dataclass(frozen=True)
class Cfg:
    robot: Literal["mujoco", "go1", "go2"] = "mujoco"
    """mujoco: simulated, with a simulated camera. go1, go2: real, with a RealSense."""
    bundle: str = "go1-parkour"
    """Folder of the policy, or the name of one that ships."""
    mode: str = "memory"
    """Mode of the pilot: memory, switch, camera or blind."""
    speed: float = 0.5
    """Forward speed, m/s."""
    seconds: float = 6.0
    """Seconds of walking."""
    fault: str = "blackout@4s+1s"
    """What the camera meets, in seconds after the start."""


def make_devices(cfg: Cfg, manifest: Manifest) -> tuple[RobotDriver, Camera]:
    """The robot and its camera, both not started yet."""
    simulated = cfg.robot == "mujoco"
    robot = ROBOTS[cfg.robot]().build(manifest.robot, live=not simulated, seed=0, dry_run=False)
    lens = CAMERAS["sim" if simulated else "realsense"]()
    camera = lens.build(manifest.camera, robot, seed=0)
    return robot, FaultyCamera(camera, [parse_fault(cfg.fault)], robot.now, seed=0)


def command(robot: RobotDriver, position: np.ndarray, manifest: Manifest) -> None:
    """Let the joints' servos hold positions [12] rad until the next control step."""
    gains = manifest.robot.arrays
    servos = JointCommand(position, gains["stiffness"], gains["damping"])
    robot.write(clamp(robot.description, servos, robot.read()))


def stand_up(robot: RobotDriver, camera: Camera, manifest: Manifest) -> None:
    """Move from where the joints are to the default pose."""
    pose = manifest.robot.arrays["default_position"]
    lying = robot.read().joint_position
    begun = robot.now()
    while (passed := robot.now() - begun) < STAND_UP:
        camera.latest()
        command(robot, lying + passed / STAND_UP * (pose - lying), manifest)
        robot.wait(begun + passed + CONTROL_DT)


def walk(robot: RobotDriver, camera: Camera, manifest: Manifest, cfg: Cfg) -> list[str]:
    """Walk straight ahead; returns the states that the pilot went through."""
    pilot = renet.load(cfg.bundle, mode=cfg.mode)
    steering = STEERINGS[manifest.told]()
    steering.start(heading(robot.read().quaternion))
    action = np.zeros(len(manifest.robot.joints))
    shown = None
    states = []
    begun = robot.now()
    while (now := robot.now()) < begun + cfg.seconds:
        # The robot's sensors, and where it is to go.
        state = robot.read()
        if -projected_gravity(state.quaternion)[2] < LEAST_UPRIGHT:
            return [*states, "fallen"]
        told = steering.command(Velocity(cfg.speed, 0.0, 0.0), heading(state.quaternion))
        observation = observe(state, manifest.robot, told, action)
        # The pilot is given an image once, when it is new.
        frame = camera.latest()
        image = None if frame is None or frame is shown else frame.image[None]
        shown = frame
        step = pilot.step(observation[None], image, now)
        command(robot, step.joint_target[0], manifest)
        action = step.action[0]
        if states[-1:] != [step.state[0]]:
            states.append(str(step.state[0]))
            print(f"{now:6.2f} s  {step.state[0]}: {step.reason[0] or 'vision is healthy'}")
        robot.wait(now + CONTROL_DT)
    return states


def brake(robot: RobotDriver, manifest: Manifest) -> None:
    """Let the joints brake for half a second, in which the robot sinks down."""
    still = np.zeros(len(manifest.robot.joints))
    braked = JointCommand(manifest.robot.arrays["default_position"], still, still + BRAKING)
    robot.write(clamp(robot.description, braked))
    robot.wait(robot.now() + 0.5)


def main(cfg: Cfg) -> list[str]:
    """Deploy; however it ends, the robot brakes."""
    manifest = Bundle.load(cfg.bundle).manifest
    robot, camera = make_devices(cfg, manifest)
    robot.connect()
    try:
        camera.start()
        stand_up(robot, camera, manifest)
        return walk(robot, camera, manifest, cfg)
    finally:
        brake(robot, manifest)
        robot.close()


if __name__ == "__main__":
    try:
        print(" → ".join(main(tyro.cli(Cfg, description=__doc__))))
    except RenetError as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from error
