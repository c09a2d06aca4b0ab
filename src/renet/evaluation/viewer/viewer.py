"""mjlab's viewer in the browser, with panels for what RENet sees and buttons that break it."""

import io
import math
import socket
import warnings
from contextlib import redirect_stdout
from dataclasses import replace

import viser
from mjlab.viewer import ViserPlayViewer

from renet.errors import RenetError
from renet.evaluation.viewer.panels import VisionPanels
from renet.evaluation.viewer.session import ViewerSession
from renet.interface import STEPS_PER_TICK


class LiveViewer(ViserPlayViewer):
    """mjlab's viewer plus `VisionPanels`, which follow the 10 Hz tick."""

    def __init__(self, session: ViewerSession, server: viser.ViserServer) -> None:
        # mjlab expects observations to be tensors; they only pass from the session to the session.
        super().__init__(session, session.act, viser_server=server)  # pyright: ignore[reportArgumentType]
        # In the browser elevation is the camera's; in MuJoCo it is that of its line of sight.
        self.cfg = replace(self.cfg, elevation=-self.cfg.elevation)
        self.session = session
        self._shown = 0

    def setup(self) -> None:
        """Add the panels, then set up as mjlab does."""
        self.panels = VisionPanels(self._server, self.session)
        super().setup()

    def sync_env_to_viewer(self) -> None:
        """Update the scene, and at every tick the panels."""
        super().sync_env_to_viewer()
        tick = math.ceil(self._step_count / STEPS_PER_TICK)
        if tick != self._shown:
            self._shown = tick
            self.panels.update(self._step_count)

    def reset_environment(self) -> None:
        """Put the robot back and empty the curves."""
        super().reset_environment()
        self._shown = 0
        self.panels.clear()


def serve(host: str, port: int) -> viser.ViserServer:
    """A server on exactly this port; raises RenetError if something else has it."""
    with socket.socket() as probe:
        # As the server itself will: a port that was closed a moment ago is free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise RenetError(f"cannot serve on {host}:{port} ({error}): choose --port") from error
    with redirect_stdout(io.StringIO()):
        return viser.ViserServer(host, port, label="renet", verbose=False)


def watch(session: ViewerSession, host: str, port: int, steps: int | None = None) -> None:
    """Show a session in the browser until Ctrl-C, or for a number of control steps.

    Raises:
        RenetError: the port is taken.
    """
    server = serve(host, port)
    try:
        print(f"Open http://{host}:{port} in a browser; Ctrl-C ends.", flush=True)
        with redirect_stdout(io.StringIO()), warnings.catch_warnings(action="ignore"):
            LiveViewer(session, server).run(num_steps=steps)
    finally:
        server.stop()
        session.close()
