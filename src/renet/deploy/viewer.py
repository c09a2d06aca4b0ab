"""The simulated robot in a browser, for `renet deploy --viewer`."""

from typing import Any

import mujoco

from renet.errors import RenetError

EVERY = 2
"""Control steps from one picture to the next: 25 pictures a second."""


class BrowserViewer:
    """Serves the scene; viser tells the address."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, host: str) -> None:
        """Listen at an address of this computer; raises RenetError if mjviser is not installed."""
        try:
            import mjviser
            import viser
        except ModuleNotFoundError as error:
            raise RenetError(f"--viewer needs {error.name}: pip install mjviser") from error
        self._data, self._steps = data, 0
        server = viser.ViserServer(host)
        server.gui.configure_theme(show_share_button=False)  # It would open a public tunnel.
        self._scene: Any = mjviser.ViserMujocoScene(server, model, num_envs=1)
        # The robot has no visual meshes: show the shapes it collides with.
        self._scene.geom_groups_visible[3] = True
        self._scene.rebuild_visual_handles()

    def show(self) -> None:
        """Show the newest state, now and then."""
        if self._steps % EVERY == 0:
            self._scene.update_from_mjdata(self._data)
        self._steps += 1
