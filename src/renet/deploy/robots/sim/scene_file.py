"""The user's MJCF as the ground of a simulated robot, with checks that it can be that.

The file is first tried in a process with limits: it is compiled, checked, and simulated with the
robot on it.
"""

import sys
from pathlib import Path

import mujoco

from renet.deploy.robots.sim.concavity import demand_convex
from renet.deploy.robots.sim.mujoco import UNSEEN_GROUP, check_physics, place
from renet.errors import RenetError
from renet.files import require_regular
from renet.robots import Robot
from renet.robots.model import simulation_model
from renet.terrain.own_ground import MAX_SCENE, SCENE, TOUCHED, ground_height
from renet.trial import judge, run_trial

SEEN_GROUP = 0
"""MuJoCo group of the geoms of a scene that a robot can touch."""
TRIAL_STEPS = 200
"""Number of physics steps of the trial, 1 s."""


def attach_scene(spec: mujoco.MjSpec, file: Path) -> None:
    """Add an MJCF file's static geoms to a robot's model, whose physics options stay.

    Raises:
        RenetError: The file is not an MJCF that MuJoCo reads, or something in it moves.
    """
    try:
        scene = mujoco.MjSpec.from_file(str(file))
        if scene.joints:
            raise RenetError(
                f"its body {scene.joints[0].parent.name!r} moves: give the ground alone, without "
                "robots or other bodies that have joints"
            )
        # MuJoCo warns of options that differ from those of the robot.
        scene.option = spec.option
        scene.memory = spec.memory
        show_what_collides(scene)
        spec.attach(scene, prefix="scene/", frame=spec.worldbody.add_frame())
    except ValueError as error:
        raise RenetError(f"{' '.join(str(error).split())}; give MJCF that MuJoCo loads") from error


def show_what_collides(scene: mujoco.MjSpec) -> None:
    """Let a camera see the geoms that a robot can touch, and no others.

    A scene may hide colliding shapes in a group that rays pass through, or hold shapes for the eye
    alone. A robot would walk into what it cannot see, or through what it sees.
    """
    for geom in scene.geoms:
        collides = bool(geom.contype & TOUCHED)
        geom.group = SEEN_GROUP if collides else UNSEEN_GROUP
        if collides:
            # Rays pass through what is invisible.
            geom.rgba[3] = 1.0
            geom.material = ""


def try_scene(file: Path, robot: Robot) -> None:
    """Raise RenetError unless a robot can stand in a scene, which is not loaded in this process."""
    require_regular(file, MAX_SCENE, "scene")
    # Nor is a process started for what its name already tells.
    if file.suffix.lower() != SCENE:
        raise RenetError(
            f"cannot use the scene {file}: {file.name} is no MJCF: give an .xml file, in which "
            "meshes may be, or a height map (.npy, .png)"
        )
    arguments = [str(file), simulation_model(robot).to_xml(), str(robot.height)]
    run_trial("renet.deploy.robots.sim.scene_file", arguments, f"cannot use the scene {file}")


def _trial() -> str:
    """Try the scene of the command line; returns its problem in a line, empty if it has none."""
    file, mjcf, height = sys.argv[1:]
    spec = mujoco.MjSpec.from_string(mjcf)
    try:
        attach_scene(spec, Path(file))
        model = spec.compile()
        demand_convex(model)
        data = place(model, ground_height(model) + float(height))
        for _ in range(TRIAL_STEPS):
            mujoco.mj_step(model, data)
            check_physics(model, data)
    except MemoryError:
        return "it needs too much memory"
    except (RenetError, ValueError) as error:
        return " ".join(str(error).split())
    return ""


if __name__ == "__main__":
    judge(_trial)
