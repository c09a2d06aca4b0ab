"""Draws where a bundle's camera sits on its robot: python tools/mount_drawing.py.

The robot is that of its description, in the pose of the bundle; every number is the bundle's. The
distances that are printed are for checking a mount (docs/deploy.md).
"""

import io
import math
from pathlib import Path

import matplotlib as mpl
import mujoco
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull

from renet.bundle import SHIPPED, Bundle
from renet.bundle.manifest import CameraSpec, RobotSpec
from renet.evaluation.figures import BACKGROUND
from renet.files import write_atomically
from renet.interface import JOINTS, TRUNK
from renet.robots import find_robot
from renet.robots.model import simulation_model

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
BODY, EDGE, LENS, SIZES = "#c9ced6", "#7d8694", "#0072b2", "#a3121f"
SEEN = 0.12
"""Opacity of what the camera sees."""
AROUND = 24
"""Points around a round shape."""
BESIDE = 0.42
"""Distance from the lens to its height's line, m, so that what the camera sees is not crossed."""


def draw(bundle: Bundle) -> bytes:
    """The drawing of a bundle's mount from the side and from above, as SVG."""
    camera, robot = bundle.manifest.camera, bundle.manifest.robot
    shapes, trunk = robot_shapes(robot)
    x, y, z = camera.position
    figure = Figure(figsize=(10, 3.2), layout="constrained", facecolor=BACKGROUND)
    side, above = figure.subplots(1, 2, width_ratios=(1.3, 1.0))
    for axis, (first, second) in ((side, (0, 2)), (above, (0, 1))):
        for points in shapes:
            flat = (points - trunk)[:, [first, second]]
            outline = flat[ConvexHull(flat).vertices]
            axis.fill(*outline.T, facecolor=BODY, edgecolor=EDGE, linewidth=0.6)
        axis.plot(0, 0, "+", color=SIZES, markersize=12)
        axis.set_aspect("equal")
        axis.set_axis_off()
    floor = -trunk[2]
    side.axhline(floor, color=EDGE, linewidth=1.0)
    draw_view(side, camera, floor)
    hip = front_joints(robot)
    side.plot(hip, 0, "o", color=SIZES, markersize=4)
    dimension(side, (0, z), (x, z), millimetres(x), 0.2)
    dimension(side, (hip, z), (x, z), millimetres(x - hip), 0.11)
    dimension(side, (x, 0), (x, z), millimetres(z), BESIDE)
    # Room for the upper length below the title.
    side.set_ylim(floor - 0.02, z + 0.27)
    draw_offset(above, x, y)
    dimension(above, (0, y), (x, y), millimetres(x), -0.25)
    marks = "+ middle of the trunk, red dot: front thigh joints"
    side.set_title(f"{robot.name} from the left\n{marks}", fontsize=10)
    above.set_title("from above (left is up)\nblue dot: the left infrared imager", fontsize=10)
    picture = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "renet"}):
        figure.savefig(picture, format="svg", metadata={"Date": None})
    return picture.getvalue()


def millimetres(length: float) -> str:
    """A length in m as a text in mm."""
    return f"{round(1000 * length, 1):g} mm"


def floor_distance(camera: CameraSpec, height: float) -> float:
    """Distance ahead of a lens at a height, both in m, at which its axis meets the floor.

    What stands there crosses the middle row of the image if the trunk is level.
    """
    return height / math.tan(camera.pitch)


def front_joints(robot: RobotSpec) -> float:
    """Distance from the middle of the trunk ahead to the axis of the front thigh joints, m.

    The axis is as high as the middle of the trunk.
    """
    model = simulation_model(find_robot(robot.name)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return float((data.joint("FL_thigh_joint").xanchor - data.body(TRUNK).xpos)[0])


def robot_shapes(robot: RobotSpec) -> tuple[list[np.ndarray], np.ndarray]:
    """Points [K, 3] m of each shape that a standing robot collides with, and of its trunk, [3]."""
    description = find_robot(robot.name)
    model = simulation_model(description).compile()
    data = mujoco.MjData(model)
    for name, angle in zip(JOINTS, robot.default_position, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    shapes = [
        shape_points(model, data, geom)
        for geom in np.flatnonzero(model.geom_group == 3).tolist()
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE
    ]
    trunk = data.body(TRUNK).xpos.copy()
    # On the ground: the lowest point of all is a foot's.
    lowest = min(points[:, 2].min() for points in shapes)
    return [points - (0, 0, lowest) for points in shapes], trunk - (0, 0, lowest)


def shape_points(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    """Points [K, 3] m whose convex hull is a geom's."""
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    ball = _ball()
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        local = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * size
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        local = ball * size[0]
    elif kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        local = model.mesh_vert[first : first + count]
    else:
        ends = np.array([[0, 0, size[1]], [0, 0, -size[1]]])
        flat = kind == mujoco.mjtGeom.mjGEOM_CYLINDER
        around = ball * (1, 1, 0) if flat else ball
        local = (ends[:, None] + around * size[0]).reshape(-1, 3)
    return local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]


def _ball() -> np.ndarray:
    """Points on a unit sphere, [K, 3]."""
    turn, tilt = np.meshgrid(np.linspace(0, 2 * np.pi, AROUND), np.linspace(0, np.pi, AROUND))
    points = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], -1)
    return points.reshape(-1, 3)


def draw_view(axis: Axes, camera: CameraSpec, floor: float) -> None:
    """Draw lens, axis and the rows that the policy sees, down to the floor, from the side."""
    x, _, z = camera.position
    half = math.atan(camera.height / 2 / camera.fy)
    corners = [(x, z)]
    for angle in (camera.pitch - half, camera.pitch, camera.pitch + half):
        far = min(camera.range / math.cos(angle - camera.pitch), 0.85)
        down = (z - floor) / math.sin(angle) if angle > 0 else math.inf
        length = min(far, down)
        corners.append((x + length * math.cos(angle), z - length * math.sin(angle)))
    lens, upper, middle, lower = corners
    axis.fill(*zip(lens, upper, middle, lower, strict=True), color=LENS, alpha=SEEN, linewidth=0)
    axis.plot(*zip(lens, middle, strict=True), color=LENS, linestyle="-.", linewidth=0.9)
    axis.plot(*lens, "o", color=LENS, markersize=6)
    axis.plot((x, x + 0.4), (z, z), color=LENS, linewidth=0.6)
    # Below the axis, left of a point on it.
    place = (x + 0.6 * (middle[0] - x), z + 0.6 * (middle[1] - z) - 0.01)
    down = f"{math.degrees(camera.pitch):.0f}° down"
    axis.text(*place, down, color=SIZES, fontsize=9, ha="right", va="top")


def draw_offset(axis: Axes, x: float, y: float) -> None:
    """Draw the lens from above at (x, y), m, and its distance from the robot's middle."""
    axis.plot((0, x + 0.1), (0, 0), color=EDGE, linestyle="-.", linewidth=0.8)
    axis.plot(x, y, "o", color=LENS, markersize=6)
    place = (x + 0.1, y + (0.1 if y > 0 else -0.1))
    side = f"{millimetres(abs(y))} to the {'left' if y > 0 else 'right'}" if y else "centred"
    arrow = {"arrowstyle": "->", "color": SIZES}
    axis.annotate(side, (x, y), place, color=SIZES, fontsize=9, va="center", arrowprops=arrow)


def dimension(
    axis: Axes, start: tuple[float, float], end: tuple[float, float], text: str, away: float
) -> None:
    """Draw a length between two points, moved `away` from them, m: up, or to the right."""
    level = start[1] == end[1]
    shift = np.array((0.0, away) if level else (away, 0.0))
    (x1, y1), (x2, y2) = start + shift, end + shift
    arrow = {"arrowstyle": "<->", "color": SIZES, "shrinkA": 0, "shrinkB": 0}
    axis.annotate("", (x1, y1), (x2, y2), arrowprops=arrow)
    for (a, b), (c, d) in ((start, (x1, y1)), (end, (x2, y2))):
        axis.plot((a, c), (b, d), color=SIZES, linewidth=0.5)
    # Left of the end, where a longer length's line may pass.
    place = (x2 - 0.012, y1 + 0.015) if level else (x1 + 0.015, (y1 + y2) / 2)
    side, middle = ("right", "baseline") if level else ("left", "center")
    axis.text(*place, text, color=SIZES, fontsize=9, ha=side, va=middle)


if __name__ == "__main__":
    # Both bundles of a Go1 have the same mount.
    for name in SHIPPED:
        bundle = Bundle.load(name)
        path = FIGURES / f"{name.split('-')[0]}_mount.svg"
        write_atomically(path, draw(bundle))
        camera = bundle.manifest.camera
        _, trunk = robot_shapes(bundle.manifest.robot)
        height = trunk[2] + camera.position[2]
        ahead = floor_distance(camera, height)
        times = floor_distance(camera, 1.0)
        print(f"{path}: lens {height:.2f} m above the floor, axis meets it {ahead:.2f} m ahead")
        print(f"at other heights: {times:.2f} times the height")
