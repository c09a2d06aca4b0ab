"""`renet bundle inspect`: what exactly a policy is fed, number by number."""

from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from renet.deploy.bundle import Bundle
from renet.deploy.bundle.manifest import Manifest
from renet.deploy.bundle.models import MODELS

AXES = ("x", "y", "z")
ELEMENTS = {"command": ("c_x", "sin(c_yaw - yaw)", "cos(c_yaw - yaw)")}


@dataclass(frozen=True)
class InspectCfg:
    """Print a bundle's inputs, robot and camera."""

    bundle: tyro.conf.Positional[Path | None] = None
    """Bundle folder; the one that ships with renet by default."""


def inspect(cfg: InspectCfg) -> None:
    """Verify a bundle and print it; raises RenetError if it is damaged."""
    bundle = Bundle.load(cfg.bundle)
    manifest = bundle.manifest
    console = Console(markup=False)  # A bundle's texts are a stranger's.
    console.print(f"{bundle.name} {bundle.sha256[:12]}  {bundle.path}")
    sizes = [(bundle.path / f"{name}.onnx").stat().st_size for name in MODELS]
    console.print(f"models {sum(sizes) / 1e6:.2f} MB, {manifest.provenance}")
    console.print(f"selector {manifest.selector}")
    console.print(f"camera {manifest.camera}")
    console.print(_robot_table(manifest))
    console.print(_input_table(manifest))


def input_rows(manifest: Manifest) -> list[tuple[int, str, str, float]]:
    """(index, name, unit, scale) of every number of o_t."""
    rows = []
    for term in manifest.proprioception:
        for element in range(term.size):
            rows.append((len(rows), _element(manifest, term.name, element), term.unit, term.scale))
    return rows


def _element(manifest: Manifest, term: str, element: int) -> str:
    if term in ELEMENTS:
        return f"{term} {ELEMENTS[term][element]}"
    if term.startswith("joint") or term == "last_action":
        return f"{term} {manifest.robot.joints[element]}"
    return f"{term} {AXES[element]}"


def _input_table(manifest: Manifest) -> Table:
    table = Table("index", "input", "unit", "scale", title="proprioception o_t")
    for index, name, unit, scale in input_rows(manifest):
        table.add_row(str(index), name, Text(unit), f"{scale:g}")
    return table


def _robot_table(manifest: Manifest) -> Table:
    robot = manifest.robot
    table = Table(
        "action",
        "joint",
        "default rad",
        "range rad",
        "Kp",
        "Kd",
        "limit N m",
        title=Text(robot.name),
    )
    for i, joint in enumerate(robot.joints):
        table.add_row(
            str(i),
            joint,
            f"{robot.default_position[i]:+.2f}",
            f"{robot.lower[i]:+.2f} … {robot.upper[i]:+.2f}",
            f"{robot.stiffness[i]:g}",
            f"{robot.damping[i]:g}",
            f"{robot.torque_limit[i]:g}",
        )
    table.caption = (
        f"target = default + {robot.action_scale:g} · action, |action| ≤ {robot.action_clip:g}; "
        "positive angles turn about +x (hip) and +y (thigh, calf)"
    )
    return table
