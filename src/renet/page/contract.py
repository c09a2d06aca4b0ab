"""What the page's modules share with the runtime, as one JSON file: JavaScript keeps no copies."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from renet import __version__
from renet.camera import Intrinsics
from renet.deploy.cameras.sim import RELATIVE_STD
from renet.deploy.controller import MAX_LEAD
from renet.deploy.robots.mujoco import SEEN_GROUPS
from renet.deploy.robots.scene import FLAT, scene_spec
from renet.deploy.safety import SafetyCfg
from renet.descriptions import GO1
from renet.faults import FAULTS, SEVERITIES, Fault, combined, stereo, vegetation
from renet.faults.physical import Glass, obstacles, spread
from renet.interface import (
    CONTROL_DT,
    DEPTH_SHAPE,
    HEIGHT_MAP_X,
    HEIGHT_MAP_Y,
    LATENT,
    MAX_SPEED,
    PHYSICS_DT,
    PROPRIOCEPTION,
    STEPS_PER_TICK,
    TRUNK,
)
from renet.palette import STATES
from renet.selector.filter import VISION_THRESHOLD
from renet.selector.monitors import COVERED, MONITORS, NEAR
from renet.selector.selector import BETWEEN_RETURNS, DWELL

MAP_HEIGHT = 0.3
"""Metres of the base above the ground that read as zero in a height map, as in training."""
SCENES = {
    FLAT: ("Flat ground", 1),
    "stairs_up": ("Stairs up", 2),
    "stairs_down": ("Stairs down", 2),
    "platform": ("Platform", 3),
    "gap": ("Gap", 4),
}
"""Terrains of the page: what they are called, and their level of 1 to 10."""


def contract() -> dict[str, Any]:
    """JSON values: sizes, limits and thresholds of the runtime, the scenes, and the faults.

    Infinite durations are null.
    """
    return {
        "renet": __version__,
        "controlDt": CONTROL_DT,
        "physicsDt": PHYSICS_DT,
        "stepsPerTick": STEPS_PER_TICK,
        "depthShape": DEPTH_SHAPE,
        "latent": LATENT,
        "proprioception": [asdict(term) for term in PROPRIOCEPTION],
        "heightMap": {"x": HEIGHT_MAP_X, "y": HEIGHT_MAP_Y, "baseHeight": MAP_HEIGHT},
        "safety": asdict(SafetyCfg()),
        "maxLead": MAX_LEAD,
        "maxSpeed": MAX_SPEED,
        "base": {"body": TRUNK, "height": GO1.height},
        "camera": {
            "relativeStd": RELATIVE_STD,
            "seenGroups": SEEN_GROUPS.tolist(),
            "focalPixels": Intrinsics.fx,
            "stereo": {
                "focal": stereo.FOCAL,
                "baseline": stereo.BASELINE,
                "nearest": stereo.NEAREST,
                "flatDisparity": stereo.FLAT_DISPARITY,
            },
            "grass": _grass(),
            "parts": {name: _parts(fault) for name, fault in FAULTS.items() if _parts(fault)},
        },
        "selector": {
            "visionThreshold": VISION_THRESHOLD,
            "dwell": DWELL,
            "betweenReturns": BETWEEN_RETURNS,
            "near": NEAR,
            "covered": COVERED,
            "monitors": [
                {
                    "name": name,
                    "reason": monitor.reason,
                    "fallback": monitor.fallback,
                    "output": monitor.output,
                    "ofImage": monitor.of_image,
                }
                for name, monitor in MONITORS.items()
            ],
        },
        "palette": {state: colour for state, (colour, _) in STATES.items()},
        "faults": [_fault(fault) for fault in FAULTS.values()],
        "scenes": [_scene(terrain, *SCENES[terrain]) for terrain in SCENES],
    }


def _fault(fault: type[Fault]) -> dict[str, Any]:
    return {
        "name": fault.name,
        "summary": fault.summary(),
        "levels": [_finite(level) for level in fault.levels],
        "described": [fault.describe(fault.level_of(severity)) for severity in SEVERITIES],
        "lasts": [_finite(fault.lasts(level)) for level in fault.levels],
    }


def _grass() -> dict[str, Any]:
    lens = Intrinsics()
    return {
        **{name: getattr(lens, name) for name in ("fx", "fy", "cx", "cy")},
        "pitch": vegetation.CAMERA_PITCH,
        "cameraHeight": vegetation.CAMERA_HEIGHT,
        "nearRange": vegetation.NEAR_RANGE,
        "reach": vegetation.REACH,
        "height": vegetation.HEIGHT,
        "width": vegetation.WIDTH,
        "sway": vegetation.SWAY,
        "unmatched": vegetation.UNMATCHED,
    }


def _parts(fault: type[Fault]) -> list[Any]:
    """Levels of the faults that a fault is made of; of one that comes and goes, its only level."""
    if issubclass(fault, combined.TwoFaults):
        return [[_finite(level) for level in kind.levels] for kind in fault.kinds]
    if issubclass(fault, combined.Intermittent):
        return [_finite(fault.kind.level_of(fault.severity))]
    return []


def _scene(terrain: str, title: str, level: int) -> dict[str, Any]:
    spec, start = scene_spec(terrain, level)
    model = spec.compile()
    glass = None
    if terrain in Glass.terrains:
        found = obstacles(model, np.zeros((1, 2)))
        glass = [sorted(spread(found, share)) for share in Glass.levels]
    return {"name": terrain, "title": title, "xml": spec.to_xml(), "start": start, "glass": glass}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
