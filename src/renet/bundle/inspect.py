"""`renet bundle inspect`: what exactly a policy is fed, number by number."""

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
"""Names of the numbers of a term; every other term has one number for each joint."""


@dataclass(frozen=True)
class InspectCfg:
    """Print a bundle's inputs, robot and camera."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder, or the name of one that ships: go1-parkour (the default), go2-parkour; or
    hf://OWNER/NAME on the Hugging Face Hub."""


def inspect(cfg: InspectCfg) -> None:
    """Verify a bundle and print it; raises RenetError if it is damaged."""
    bundle = Bundle.load(cfg.bundle)
    manifest, robot = bundle.manifest, bundle.manifest.robot
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
    """Index, name, default position, range, gains and torque limit of every joint."""
    ranges = [f"{a:+.2f} … {b:+.2f}" for a, b in zip(robot.lower, robot.upper, strict=True)]
    gains = zip(robot.stiffness, robot.damping, robot.torque_limit, strict=True)
    columns = zip(robot.joints, robot.default_position, ranges, gains, strict=True)
    return [
        (index, joint, f"{position:+.2f}", limits, *(f"{gain:g}" for gain in joint_gains))
        for index, (joint, position, limits, joint_gains) in enumerate(columns)
    ]


def input_rows(manifest: Manifest) -> list[tuple[int | str, ...]]:
    """Index, name, unit and scale of every number of o_t."""
    rows = [
        (f"{term.name} {element}", term.unit, f"{term.scale:g}")
        for term in manifest.proprioception
        for element in ELEMENTS.get(term.name, manifest.robot.joints)
    ]
    return [(index, *row) for index, row in enumerate(rows)]
