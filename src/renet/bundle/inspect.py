"""`renet bundle inspect`: every number that a policy is fed, and what it drives."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from renet.bundle import Bundle
from renet.bundle.manifest import CameraSpec, Manifest, ProvenanceSpec, RobotSpec
from renet.bundle.models import MODELS
from renet.interface import Told
from renet.selector.selector import SelectorSpec
from renet.terminal import show

ELEMENTS = {
    "base_angular_velocity": ("x", "y", "z"),
    "projected_gravity": ("x", "y", "z"),
}
"""Names of the numbers of a term. The command's are `COMMAND_ELEMENTS`; every other term has one
number for each joint."""
COMMAND_ELEMENTS: dict[Told, tuple[str, ...]] = {
    "heading": ("c_x", "sin(c_yaw - yaw)", "cos(c_yaw - yaw)"),
    "twist": ("v_x", "v_y", "omega_z"),
}
"""Names of the command's numbers, by its form."""

FIELD_UNITS = {
    "steps": "of all robots together",
    "seconds": "s",
    "rate_hz": "1/s",
    "false_alarms_per_hour": "1/h",
    "healthy_hours": "h",
    "longest_memory": "s",
    "fx": "pixels",
    "fy": "pixels",
    "cx": "pixels",
    "cy": "pixels",
    "height": "pixels",
    "width": "pixels",
    "range": "m",
    "position": "m: ahead, left, up from the middle of the trunk",
    "pitch": "rad, downward",
    "noise_std": "m",
}
"""Units of the fields of provenance, selector and camera, by their names."""


@dataclass(frozen=True)
class InspectCfg:
    """Print a bundle's inputs, robot and camera."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or the name of one that ships: go1-parkour (the default), go1-driven,
    go2-parkour, go2-driven; or hf://OWNER/NAME on the Hugging Face Hub."""


def inspect(cfg: InspectCfg) -> None:
    """Verify a bundle and print it; raises RenetError if it is damaged."""
    bundle = Bundle.load(cfg.bundle)
    manifest = bundle.manifest
    robot = manifest.robot
    print(f"{bundle.name} {bundle.sha256[:12]}  {bundle.path}")
    sizes = [(bundle.path / f"{name}.onnx").stat().st_size for name in MODELS]
    print(f"models {sum(sizes) / 1e6:.2f} MB")
    for part in ("provenance", "selector", "camera"):
        show(part, ("name", "value", "unit"), field_rows(getattr(manifest, part)))
    header = ("action", "joint", "default rad", "range rad", "Kp", "Kd", "limit N m")
    show(robot.name, header, joint_rows(robot))
    print(
        f"target = default + {robot.action_scale:g} · action, |action| ≤ {robot.action_clip:g}; "
        "positive angles turn about +x (hip) and +y (thigh, calf)"
    )
    show("proprioception o_t", ("index", "input", "unit", "scale"), input_rows(manifest))


def field_rows(part: ProvenanceSpec | SelectorSpec | CameraSpec) -> list[tuple[str, str, str]]:
    """Return name, value and unit of every field of a part of the manifest."""
    rows = []
    for name, value in vars(part).items():
        if isinstance(value, dict):
            # One line for each threshold of a monitor.
            for key, number in value.items():
                rows.append((f"{name}.{key}", _text(number), ""))
        else:
            rows.append((name, _text(value), FIELD_UNITS.get(name, "")))
    return rows


def _text(value: object) -> str:
    """Return a value without the digits that nobody needs, and without Python's quotes."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (tuple, list)):
        return ", ".join(map(_text, value))
    return str(value)


def joint_rows(robot: RobotSpec) -> list[tuple[int | str, ...]]:
    """Return index, name, default position, range, gains and torque limit of every joint."""
    rows = []
    for index, joint in enumerate(robot.joints):
        row = (
            index,
            joint,
            f"{robot.default_position[index]:+.2f}",
            f"{robot.lower[index]:+.2f} … {robot.upper[index]:+.2f}",
            f"{robot.stiffness[index]:g}",
            f"{robot.damping[index]:g}",
            f"{robot.torque_limit[index]:g}",
        )
        rows.append(row)
    return rows


def input_rows(manifest: Manifest) -> list[tuple[int | str, ...]]:
    """Return index, name, unit and scale of every number of the proprioception o_t."""
    rows = []
    elements = ELEMENTS | {"command": COMMAND_ELEMENTS[manifest.told]}
    for term in manifest.proprioception:
        for element in elements.get(term.name, manifest.robot.joints):
            rows.append((len(rows), f"{term.name} {element}", term.unit, f"{term.scale:g}"))
    return rows
