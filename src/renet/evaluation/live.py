"""A window or a browser in which robots are watched while they walk."""

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
"""Where robots are watched; auto: in a window where there is a display."""
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
"""Variables of the environment that say where windows appear on Linux."""
EVERY = 2
"""Control steps from one picture to the next: 25 pictures a second."""
SHAPES = 3
"""MuJoCo group of the shapes that robots collide with, shown where there are no visual meshes."""
GHOST = 0.35
"""Opacity of all robots but the last."""


class LiveView(Protocol):
    """Shows the poses of a few robots."""

    @property
    def closed(self) -> bool:
        """Whether whoever watches has had enough."""
        ...

    def show(self, poses: np.ndarray) -> None:
        """Show robots with generalised positions [R, nq], in the order of their names."""
        ...

    def close(self) -> None:
        """Let go of the window."""
        ...


def has_display() -> bool:
    """Whether a window can appear."""
    return any(os.environ.get(name) for name in DISPLAYS)


def open_view(viewer: Viewer, spec: mujoco.MjSpec, names: Sequence[str]) -> LiveView | None:
    """A view of a scene; None where nobody can watch, or nobody wants to.

    Args:
        viewer: where. spec: of the scene with one robot, which is copied.
        names: what to call the robots. The last one is the scene's own; the others are shown beside
            it, transparent.

    Raises:
        RenetError: a window is asked for, and there is no display.
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
    """Let a robot without visual meshes show what it collides with."""
    moving = model.body_weldid[model.geom_bodyid] != 0
    if not (model.geom_group[moving] < SHAPES).any():
        model.geom_group[moving] = 0


def _starts_windows() -> bool:
    """Whether GLFW reaches the display: MuJoCo's viewer would wait for ever where it does not."""
    try:
        import glfw
    except ImportError:
        return False
    return bool(glfw.init())


class WindowView:
    """MuJoCo's own viewer: one robot, and the others as ghosts with their names."""

    def __init__(self, model: mujoco.MjModel, names: Sequence[str]) -> None:
        """Open the window."""
        import mujoco.viewer

        self._model, self._names = model, names
        self._data, self._ghost = mujoco.MjData(model), mujoco.MjData(model)
        self._window: Any = mujoco.viewer.launch_passive(
            model, self._data, show_left_ui=False, show_right_ui=False
        )
        self._window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        self._window.cam.trackbodyid = model.jnt_bodyid[0]
        self._window.cam.distance, self._window.cam.elevation = 2.5, -25.0

    @property
    def closed(self) -> bool:
        """Whether the window was closed."""
        return not self._window.is_running()

    def show(self, poses: np.ndarray) -> None:
        """Show robots with generalised positions [R, nq]."""
        if self.closed:
            return
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
        options, nothing = mujoco.MjvOption(), mujoco.MjvPerturb()
        moving = mujoco.mjtCatBit.mjCAT_DYNAMIC
        mujoco.mjv_addGeoms(self._model, self._ghost, options, nothing, moving, scene)
        for geom in scene.geoms[first : scene.ngeom]:
            geom.rgba[:] = (*(part / 255 for part in rgb(STATES["blind"][0])), GHOST)
        if scene.ngeom > first:
            scene.geoms[first].label = name

    def close(self) -> None:
        """Close the window."""
        self._window.close()


class BrowserView:
    """The last robot in a browser; viser tells the address."""

    closed = False
    """A browser may come back."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Listen on this computer; raises RenetError if mjviser is not installed."""
        self._server = serve_scene(LOOPBACK)
        import mjviser

        self._model, self._data = model, mujoco.MjData(model)
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
    """Keeps a simulation that is watched from running ahead of the wall clock."""

    def __init__(self) -> None:
        self._begun = time.monotonic()

    def wait(self, step: int) -> None:
        """Return when a control step, counted from 0, is over by the clock."""
        ahead = self._begun + (step + 1) * CONTROL_DT - time.monotonic()
        time.sleep(max(ahead, 0.0))
