"""Live views of walking robots, in a window or a browser."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import Any, Literal, Protocol

import mujoco
import numpy as np

from renet.errors import RenetError
from renet.interface import CONTROL_DT
from renet.palette import STATES, rgb
from renet.server import LOOPBACK, serve_scene

Viewer = Literal["auto", "window", "browser", "none"]
"""Place of the view; auto: a window if there is a display."""
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
"""Environment variables that name a display on Linux."""
STEPS_PER_PICTURE = 2
"""Number of control steps from one picture to the next: 25 pictures a second."""
_COLLISION_GROUP = 3
"""MuJoCo's group of collision geoms, which are shown if a robot has no visual meshes."""
_GHOST_OPACITY = 0.35
"""Opacity of all robots but the last."""


class LiveView(Protocol):
    """View of a few robots."""

    @property
    def closed(self) -> bool:
        """True once the user has closed the view."""
        ...

    def show(self, poses: np.ndarray) -> None:
        """Show robots with generalised positions [R, nq], in the order of their names."""
        ...

    def close(self) -> None:
        """Release the window or the port."""
        ...


def has_display() -> bool:
    """Return True if the environment names a display for windows."""
    return any(os.environ.get(name) for name in DISPLAYS)


def open_view(viewer: Viewer, spec: mujoco.MjSpec, names: Sequence[str]) -> LiveView | None:
    """Open a view of a scene; None if there is no display, or no view is wanted.

    Args:
        viewer: Place of the view.
        spec: Scene with one robot, which is copied.
        names: Names of the robots. The last one is the scene's own; the others are transparent.

    Raises:
        RenetError: A window is asked for, and there is no display.
    """
    if viewer == "none" or (viewer == "auto" and not has_display()):
        return None
    model = spec.copy().compile()
    _show_shapes(model)
    if viewer == "browser":
        return BrowserView(model)
    if not (has_display() and _starts_windows()):
        if viewer == "auto":
            return None
        raise RenetError(
            "there is no display to open a window on: take --viewer browser, or --viewer none"
        )
    return WindowView(model, names)


def _show_shapes(model: mujoco.MjModel) -> None:
    """Make the collision geoms of a robot without visual meshes visible, in place."""
    moving = model.body_weldid[model.geom_bodyid] != 0
    if not (model.geom_group[moving] < _COLLISION_GROUP).any():
        model.geom_group[moving] = 0


def _starts_windows() -> bool:
    """Return True if GLFW reaches the display."""
    # MuJoCo's viewer opens its window with GLFW, and waits forever without a display.
    try:
        import glfw
    except ImportError:
        return False
    return bool(glfw.init())


class WindowView:
    """View in MuJoCo's viewer: one robot, and the others as ghosts with their names."""

    def __init__(self, model: mujoco.MjModel, names: Sequence[str]) -> None:
        """Open the window."""
        import mujoco.viewer

        self._model = model
        self._names = names
        self._data = mujoco.MjData(model)
        self._ghost = mujoco.MjData(model)
        self._window: Any = mujoco.viewer.launch_passive(
            model, self._data, show_left_ui=False, show_right_ui=False
        )
        self._window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        self._window.cam.trackbodyid = model.jnt_bodyid[0]
        self._window.cam.distance = 2.5
        self._window.cam.elevation = -25.0

    @property
    def closed(self) -> bool:
        """True once the window is closed."""
        return not self._window.is_running()

    def show(self, poses: np.ndarray) -> None:
        """Show robots with generalised positions [R, nq]."""
        if self.closed:
            return
        # The last robot is the scene's own, the others are drawn into it.
        *others, own = poses
        with self._window.lock():
            self._data.qpos[:] = own
            mujoco.mj_forward(self._model, self._data)
            scene = self._window.user_scn
            scene.ngeom = 0
            for pose, name in zip(others, self._names, strict=False):
                self._add_ghost(scene, pose, name)
        self._window.sync()

    def _add_ghost(self, scene: Any, pose: np.ndarray, name: str) -> None:
        """Add a robot's geoms to a scene, transparent, and its name to the first of them."""
        first = scene.ngeom
        self._ghost.qpos[:] = pose
        mujoco.mj_kinematics(self._model, self._ghost)
        options = mujoco.MjvOption()
        perturbation = mujoco.MjvPerturb()
        moving = mujoco.mjtCatBit.mjCAT_DYNAMIC
        mujoco.mjv_addGeoms(self._model, self._ghost, options, perturbation, moving, scene)
        colour = np.array(rgb(STATES["blind"][0])) / 255
        for geom in scene.geoms[first : scene.ngeom]:
            geom.rgba[:] = (*colour, _GHOST_OPACITY)
        # The scene may be full already.
        if scene.ngeom > first:
            scene.geoms[first].label = name

    def close(self) -> None:
        """Close the window."""
        self._window.close()


class BrowserView:
    """View of the last robot in a browser; viser prints the address."""

    closed = False
    """Never true, for a browser may connect again."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Listen on this computer; raises RenetError if mjviser is not installed."""
        self._server = serve_scene(LOOPBACK)
        import mjviser

        self._model = model
        self._data = mujoco.MjData(model)
        self._scene: Any = mjviser.ViserMujocoScene(self._server, model, num_envs=1)

    def show(self, poses: np.ndarray) -> None:
        """Show the last of the robots with generalised positions [R, nq]."""
        self._data.qpos[:] = poses[-1]
        mujoco.mj_forward(self._model, self._data)
        self._scene.update_from_mjdata(self._data)

    def close(self) -> None:
        """Stop listening."""
        self._server.stop()


class Pacer:
    """Brake that keeps a simulation from running faster than the wall clock."""

    def __init__(self) -> None:
        self._start = time.monotonic()

    def wait(self, step: int) -> None:
        """Return when a control step, counted from 0, is over by the clock."""
        ahead = self._start + (step + 1) * CONTROL_DT - time.monotonic()
        time.sleep(max(ahead, 0.0))
