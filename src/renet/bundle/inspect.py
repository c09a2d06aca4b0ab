"""`renet bundle inspect`: every number that a policy is fed, and what it drives."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from renet.bundle import Bundle
from renet.bundle.manifest import Manifest, RobotSpec
from renet.bundle.models import MODELS
from renet.terminal import show

ELEMENTS = {
    "base_angular_velocity": ("x", "y", "z"),
    "projected_gravity": ("x", "y", "z"),
    "command": ("c_x", "sin(c_yaw - yaw)", "cos(c_yaw - yaw)"),
}
"""Names of the numbers of a term. Every other term has one number for each joint."""


@dataclass(frozen=True)
class InspectCfg:
    """Print a bundle's inputs, robot and camera."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or the name of one that ships: go1-parkour (the default), go2-parkour; or
    hf://OWNER/NAME on the Hugging Face Hub."""


def inspect(cfg: InspectCfg) -> None:
    """Verify a bundle and print it; raises RenetError if it is damaged."""
    bundle = Bundle.load(cfg.bundle)
    manifest = bundle.manifest
    robot = manifest.robot
    print(f"{bundle.name} {bundle.sha256[:12]}  {bundle.path}")
    sizes = [(bundle.path / f"{name}.onnx").stat().st_size for name in MODELS]
    print(f"models {sum(sizes) / 1e6:.2f} MB, {manifest.provenance}")
    print(f"selector {manifest.selector}")
    print(f"camera {manifest.camera}")
    header = ("action", "joint", "default rad", "range rad", "Kp", "Kd", "limit N m")
    show(robot.name, header, joint_rows(robot))
    print(
        f"target = default + {robot.action_scale:g} · action, |action| ≤ {robot.action_clip:g}; "
        "positive angles turn about +x (hip) and +y (thigh, calf)"
    )
    show("proprioception o_t", ("index", "input", "unit", "scale"), input_rows(manifest))


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
    for term in manifest.proprioception:
        for element in ELEMENTS.get(term.name, manifest.robot.joints):
            rows.append((len(rows), f"{term.name} {element}", term.unit, f"{term.scale:g}"))
    return rows
