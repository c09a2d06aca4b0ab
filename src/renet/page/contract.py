"""What the page's modules share with the runtime, as one JSON file: JavaScript keeps no copies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import mujoco
import numpy as np

from renet import __version__, interface
from renet.bundle import Bundle
from renet.deploy.cameras.sim import RELATIVE_STD
from renet.deploy.robots.sim.mujoco import SEEN_GROUPS
from renet.deploy.robots.sim.scene import FLAT, scene_spec
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.steering import FORWARD_ONLY, MAX_LEAD
from renet.deploy.teleop.keyboard import KEYS, STAND_KEY
from renet.faults import FAULTS, SEVERITIES, Fault
from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y, MAP_HEIGHT
from renet.palette import STATES, UNSEEN_AHEAD, UNSEEN_COLOUR, ink
from renet.pilot import PILOT_MODES
from renet.pilot.reach import (
    DISTANCE,
    HALF_WIDTH,
    LARGEST_RELIEF,
    OBSTACLE_END,
    SPEEDS,
    STOPPING_GROUND,
    STOPPING_MARGIN,
    UNDER_FEET,
)
from renet.robots import Robot, find_robot
from renet.selector import SelectorSpec, make_selector
from renet.selector.filter import VISION_THRESHOLD
from renet.selector.monitors import COVERED, FROZEN_PATCHES, MONITORS, NEAR, PATCH
from renet.selector.selector import AGREES, SELECTORS, STEADY
from renet.terrain.tiles import TILE

GROUNDS = {
    "gap": ("Gap", 7, "leapt the gap"),
    "stairs_down": ("Stairs down", 2, "came down the stairs"),
    "stairs_up": ("Stairs up", 2, "climbed the stairs"),
    "platform": ("Platform", 3, "crossed the platform"),
    FLAT: ("Flat ground", 1, ""),
}
"""Terrains of the page: what they are called, their level of 1 to 10, and what a robot that is
beyond the obstacle has done."""
OFFERED = {
    "blackout": "Black",
    "gaussian": "Noise",
    "salt_and_pepper": "Salt, pepper",
    "occlusion": "Mud",
    "glare": "Glare",
    "saturated": "Washed out",
    "frozen": "Frozen",
    "dropped": "Frames lost",
    "unplugged": "Unplugged",
    "mirrored": "Mirrored",
    "half_frozen": "Half frozen",
    "gain_drift": "Drifting gain",
    "wrap_around": "Wrapped",
    "floor_reflection": "Wet floor",
}
"""Faults of the catalogue that the page offers, and what it calls them; nine have keys."""
OUTPUTS = {
    "anomaly_score": "anomalyScore",
    "variance_score": "varianceScore",
    "surprise": "surprise",
    "stillness": "stillness",
}
"""Outputs of the vision model that monitors judge, and what the page's policy calls them."""
PROFILE = 0.01
"""Distance of the points at which the ground ahead is measured, m."""


def contract(bundles: Sequence[Bundle]) -> dict[str, Any]:
    """JSON values of the runtime: sizes, limits, faults, and each bundle's grounds and thresholds.

    Infinite durations are null.
    """
    return {
        "renet": __version__,
        "controlDt": interface.CONTROL_DT,
        "physicsDt": interface.PHYSICS_DT,
        "stepsPerTick": interface.STEPS_PER_TICK,
        "latent": interface.LATENT,
        "proprioception": [asdict(term) for term in interface.PROPRIOCEPTION],
        "heightMap": {"x": HEIGHT_MAP_X, "y": HEIGHT_MAP_Y, "baseHeight": MAP_HEIGHT},
        "safety": asdict(SafetyCfg()),
        "steering": _steering(),
        "modes": PILOT_MODES,
        "camera": {
            "relativeStd": RELATIVE_STD,
            "seenGroups": SEEN_GROUPS.tolist(),
            "rows": interface.DEPTH_SHAPE[0],
            "columns": interface.DEPTH_SHAPE[1],
            "range": interface.DEPTH_RANGE,
            "tickDt": interface.TICK_DT,
        },
        "visionThreshold": VISION_THRESHOLD,
        "near": NEAR,
        "covered": COVERED,
        "patch": PATCH,
        "frozenPatches": FROZEN_PATCHES,
        "steady": STEADY,
        "agrees": AGREES,
        "reach": _reach(),
        "palette": _palette(),
        "faults": [_fault(FAULTS[name], title) for name, title in OFFERED.items()],
        "bundles": [_bundle(bundle) | {"title": _title(bundle, bundles)} for bundle in bundles],
    }


def _reach() -> dict[str, Any]:
    """Ground that an image shows, and how robots behave at its end; lengths in m, speeds in m/s."""
    return {
        "distance": DISTANCE,
        "halfWidth": HALF_WIDTH,
        "margin": STOPPING_MARGIN,
        "obstacleEnd": OBSTACLE_END,
        "underFeet": UNDER_FEET.tolist(),
        "stoppingGround": STOPPING_GROUND.tolist(),
        "relief": LARGEST_RELIEF,
        "speeds": {conduct: _finite(speed) for conduct, speed in SPEEDS.items()},
    }


def _palette() -> dict[str, dict[str, str]]:
    """Colour, colour of text on it, and words of each state and of ground that was not seen."""
    entries = STATES | {"unseen": (UNSEEN_COLOUR, UNSEEN_AHEAD)}
    palette = {}
    for name, (colour, says) in entries.items():
        palette[name] = {"colour": colour, "ink": ink(colour), "says": says}
    return palette


def _steering() -> dict[str, Any]:
    """Ranges of a velocity's components, m/s and rad/s, and what else `renet deploy` steers by."""
    return {
        "ranges": {
            "forward": (-interface.MAX_REVERSE, interface.MAX_SPEED),
            "left": (-interface.MAX_SIDEWAYS, interface.MAX_SIDEWAYS),
            "turnRate": (-interface.MAX_TURN, interface.MAX_TURN),
        },
        "turnGain": interface.TURN_GAIN,
        "maxLead": MAX_LEAD,
        "forwardOnly": FORWARD_ONLY,
        "keys": KEYS,
        "standKey": STAND_KEY,
    }


def _fault(fault: type[Fault], title: str) -> dict[str, Any]:
    return {
        "name": fault.name,
        "title": title,
        "summary": fault.summary(),
        "levels": [_finite(level) for level in fault.levels],
        "described": [fault.describe(fault.level_of(severity)) for severity in SEVERITIES],
        "lasts": [_finite(fault.lasts(level)) for level in fault.levels],
    }


def _bundle(bundle: Bundle) -> dict[str, Any]:
    robot = find_robot(bundle.manifest.robot.name)
    spec = bundle.manifest.selector
    remembers = spec.longest_memory > 0.0
    grounds = []
    for terrain, (title, level, done) in GROUNDS.items():
        grounds.append(_ground(robot, terrain, title, level, done))
    return {
        "name": bundle.name,
        "robot": robot.name,
        "told": bundle.manifest.told,
        "base": {"body": interface.TRUNK, "height": robot.height},
        "opening": _opening(remembers),
        "selectors": {kind: _selector(kind, spec) for kind in SELECTORS},
        "grounds": grounds,
    }


def _title(bundle: Bundle, bundles: Sequence[Bundle]) -> str:
    """What the page calls a bundle: its robot, "Go1"; among several of that, "Go1 · driven"."""
    robot = bundle.manifest.robot.name
    others = [one for one in bundles if one.manifest.robot.name == robot]
    nickname = robot.split()[-1]
    if len(others) == 1:
        return nickname
    return f"{nickname} · {bundle.name.removeprefix(f'{nickname.lower()}-')}"


def _opening(remembers: bool) -> dict[str, Any]:
    """The scene of a visit without a link, in which the two robots end differently.

    The paper's switch notices noise and goes blind, and a gap cannot be felt for. Without a memory
    a blind robot finds its way down stairs, and one that believes black images does not.
    """
    if remembers:
        scene = {"ground": "gap", "fault": "gaussian", "left": "switch"}
    else:
        scene = {"ground": "stairs_down", "fault": "blackout", "left": "camera"}
    return scene | {"right": "memory"}


def _selector(kind: str, spec: SelectorSpec) -> dict[str, Any]:
    selector = make_selector(kind, spec)
    monitors = []
    for name, threshold in selector.thresholds.items():
        monitor = MONITORS[name]
        entry = {
            "name": name,
            "threshold": threshold,
            "reason": monitor.reason,
            "output": OUTPUTS.get(monitor.output, ""),
            "ofImage": monitor.of_image,
        }
        monitors.append(entry)
    return {
        "gamma": spec.gamma,
        "rate": spec.rate_hz,
        "dwell": selector.dwell,
        "betweenReturns": selector.between_returns,
        "longestMemory": selector.longest_memory,
        "monitors": monitors,
    }


def _ground(robot: Robot, terrain: str, title: str, level: int, done: str) -> dict[str, Any]:
    spec, start = scene_spec(terrain, level, robot=robot)
    return {
        "name": terrain,
        "title": title,
        "done": done,
        "xml": spec.to_xml(),
        "start": start,
        "obstacle": _obstacle(spec.compile(), start),
    }


def _obstacle(model: mujoco.MjModel, start: float) -> tuple[float, float] | None:
    """Where the ground ahead first and last changes its height, m from the start; None: never."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ahead = np.arange(0.0, TILE / 2, PROFILE)
    down = np.array([0.0, 0.0, -1.0])
    geom = np.zeros(1, np.int32)
    depths = []
    for x in ahead:
        eye = np.array([x, 0.0, start + TILE])
        # Static geoms count, and no body is left out.
        depths.append(mujoco.mj_ray(model, data, eye, down, SEEN_GROUPS, True, -1, geom))
    changes = ahead[1:][np.abs(np.diff(depths)) > PROFILE]
    return (float(changes[0]), float(changes[-1])) if len(changes) else None


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
