"""View of the simulated robot in a browser, for `renet deploy --viewer`."""

from typing import Any

import mujoco

from renet.server import serve_scene

_EVERY = 2
"""Number of control steps from one picture to the next: 25 pictures a second."""


class BrowserViewer:
    """Server of a scene, whose address viser prints."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, host: str) -> None:
        """Listen at an address of this computer; raises RenetError if mjviser is not installed."""
        server = serve_scene(host)
        import mjviser

        self._data = data
        self._steps = 0
        self._scene: Any = mjviser.ViserMujocoScene(server, model, num_envs=1)
        # The robot has no visual meshes: show the shapes it collides with.
        self._scene.geom_groups_visible[3] = True
        self._scene.rebuild_visual_handles()

    def show(self) -> None:
        """Count a control step, and show every second one."""
        if self._steps % _EVERY == 0:
            self._scene.update_from_mjdata(self._data)
        self._steps += 1
