"""Anyone's MJCF as the ground that a simulated robot walks on, refused where it cannot be that.

The file is first tried in a process with limits: it is compiled, looked at, and simulated with the
robot on it.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np

from renet.deploy.robots.sim.concavity import demand_convex
from renet.deploy.robots.sim.mujoco import UNSEEN_GROUP, check_physics, place
from renet.descriptions import RobotDescription
from renet.errors import RenetError
from renet.files import MEGABYTE, require_regular
from renet.trial import judge, run_trial

MAX_SCENE = 20 * MEGABYTE
"""Bytes of an MJCF file."""
HEADROOM = 0.6
"""Metres that must be free above the ground on which a robot starts."""
ABOVE, BELOW = 1e-3, 1e-6
"""Metres from a surface to the start of the next ray up and down."""
SEEN_GROUP = 0
"""MuJoCo group of the geoms of a scene that a robot can touch."""
CARRIED, IGNORED = 0, 5
"""MuJoCo groups of geoms for rays that look for ground."""
TRIAL_STEPS = 200
"""Physics steps of the trial, 1 s."""


def attach_scene(spec: mujoco.MjSpec, file: Path) -> None:
    """Add an MJCF file's static geoms to a robot's model, whose physics options stay.

    Raises:
        RenetError: the file is not an MJCF that MuJoCo reads, or something in it moves.
    """
    if file.suffix.lower() != ".xml":
        raise RenetError(f"{file.name} is no MJCF: give an .xml file, in which meshes may be")
    try:
        scene = mujoco.MjSpec.from_file(str(file))
        if scene.joints:
            raise RenetError(
                f"its body {scene.joints[0].parent.name!r} moves: give the ground alone, without "
                "robots or other bodies that have joints"
            )
        scene.option, scene.memory = spec.option, spec.memory  # MuJoCo warns of any other.
        show_what_collides(scene)
        spec.attach(scene, prefix="scene/", frame=spec.worldbody.add_frame())
    except ValueError as error:
        raise RenetError(str(error).splitlines()[0]) from error


def show_what_collides(scene: mujoco.MjSpec) -> None:
    """Let a camera see the geoms that a robot can touch, and no others.

    Scenes may hide the shapes that collide in a group that rays pass, or hold others for the eye
    alone: a robot would walk into what it cannot see, or through what it sees.
    """
    for geom in scene.geoms:
        collides = bool(geom.contype & 1)
        geom.group = SEEN_GROUP if collides else UNSEEN_GROUP
        if collides:
            # Rays pass through what is invisible.
            geom.rgba[3] = 1.0
            geom.material = ""


def try_scene(file: Path, robot: RobotDescription) -> None:
    """Raise RenetError unless a robot can stand in a scene, without loading it in this process."""
    require_regular(file, MAX_SCENE, "scene")
    arguments = [str(file), str(robot.mjcf), str(robot.height)]
    run_trial("renet.deploy.robots.sim.scene_file", arguments, f"cannot use the scene {file}")


def ground_height(model: mujoco.MjModel) -> float:
    """Height in m of the surface at x = y = 0 that carries a robot and is nearest to z = 0.

    Raises:
        RenetError: nothing there carries a robot and has room above it.
    """
    data, probe = mujoco.MjData(model), model.__copy__()
    mujoco.mj_kinematics(model, data)
    static = model.body_weldid[model.geom_bodyid] == 0
    carries = static & (model.geom_contype & 1 > 0)  # The bit that robots' geoms answer to.
    probe.geom_group[:] = np.where(carries, CARRIED, IGNORED)
    probe.geom_matid[:], probe.geom_rgba[:, 3] = -1, 1.0  # Rays pass through invisible geoms.
    groups, normal = np.arange(mujoco.mjNGROUP) == CARRIED, np.zeros((3, 1))

    def look(z: float, way: int) -> float:
        """Distance to the next surface up or down from a height, whose normal is kept."""
        eye, ray, geom = np.array([0.0, 0.0, z]), np.array([0.0, 0.0, way]), np.zeros(1, np.int32)
        return mujoco.mj_ray(probe, data, eye, ray, groups.astype(np.uint8), 1, -1, geom, normal)

    # From just above everything: rays from far away miss meshes.
    z = float(np.max(data.geom_xpos[:, 2] + model.geom_rbound)) + 1.0
    heights = []
    while (distance := look(z, -1)) >= 0.0:
        z -= distance
        if normal[2, 0] > 0.0:
            room = look(z + ABOVE, 1)
            # From within a geom, a ray upwards leaves through a surface that looks up.
            if room < 0.0 or (room >= HEADROOM and normal[2, 0] < 0.0):
                heights.append(z)
        z -= BELOW
    if not heights:
        raise RenetError(
            "nothing carries a robot at x = y = 0: put a geom there that collides (contype 1), "
            f"with {HEADROOM:g} m of room above it"
        )
    return min(heights, key=abs)


def _trial() -> str:
    """What is wrong with the scene that the command line names."""
    file, mjcf, height = sys.argv[1:]
    spec = mujoco.MjSpec.from_file(mjcf)
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
        return str(error).splitlines()[0]
    return ""


if __name__ == "__main__":
    judge(_trial)
