"""What a robot sees and believes, as panels of mjlab's viewer in the browser."""

from collections import deque

import numpy as np
import viser

from renet.evaluation.report.colormaps import beside, depth_picture, map_picture
from renet.evaluation.viewer.session import VIEWER_MODES, ViewerSession
from renet.faults import FAULTS, SEVERITIES, Injection
from renet.interface import CONTROL_DT, TICK_DT
from renet.tasks.sensors import HEIGHT_MAP

SECONDS = 10.0
"""Length of the curves."""
TICKS = round(SECONDS / TICK_DT)


class VisionPanels:
    """Depth, reconstruction, loss, P_t, estimator and height maps; buttons for every fault."""

    def __init__(self, server: viser.ViserServer, session: ViewerSession) -> None:
        self.session = session
        self._points: deque[tuple[float, float, float]] = deque(maxlen=TICKS)
        """Seconds, anomaly score and P_t of the ticks shown."""
        gui, empty = server.gui, np.zeros((8, 8, 3), np.uint8)
        with gui.add_folder("Vision"):
            self.status = gui.add_html("")
            self.images = gui.add_image(empty, label="depth | reconstruction", format="png")
            self.maps = gui.add_image(
                empty, label="ground from above: predicted | true", format="png"
            )
            self.loss = _curve(gui, "loss and its threshold β", ("loss", "β"))
            self.trust = _curve(gui, "vision probability P_t", ("P_t", "switch"), (-0.05, 1.05))
        with gui.add_folder("Drive"):
            self.mode = gui.add_dropdown("estimator", VIEWER_MODES)
            speed = session.cfg.commands["goal"].fixed_speed  # type: ignore[attr-defined]
            self.speed = gui.add_slider("m/s", 0.0, max(1.0, speed), 0.05, speed)
            self.turn = gui.add_button_group("turn", ("left", "right"))
        with gui.add_folder("Break the camera"):
            self.severity = gui.add_slider("severity", SEVERITIES[0], SEVERITIES[-1], 1, 3)
            self.clear_fault = gui.add_button("healthy", color="green")
            self.faults = {
                name: gui.add_button(name.replace("_", " "), hint=fault.summary())
                for name, fault in FAULTS.items()
            }
        self._connect()

    def _connect(self) -> None:
        """Let every control do what it says."""
        session = self.session
        self.mode.on_update(lambda _: session.choose(self.mode.value))
        self.speed.on_update(lambda _: session.steer(self.speed.value, 0.0))
        side = {"left": np.pi / 6, "right": -np.pi / 6}
        self.turn.on_click(lambda _: session.steer(self.speed.value, side[self.turn.value]))
        self.clear_fault.on_click(lambda _: session.clear_fault())
        for name, button in self.faults.items():
            button.on_click(lambda _, fault=name: self._begin(fault))

    def _begin(self, fault: str) -> None:
        """Let a fault begin, at the severity of the slider."""
        self.session.inject(Injection.of(fault, int(self.severity.value), onset=0))

    def update(self, step: int) -> None:
        """Show what the robot saw and made of it when it took control step `step`, 1 or later."""
        session, policy, loop = self.session, self.session.policy, self.session.loop
        score, probability = float(policy.anomaly_score[0]), float(loop.selector.probability[0])
        self._points.append((step * CONTROL_DT, score, probability))
        times, scores, probabilities = map(np.array, zip(*self._points, strict=True))
        self.status.content = status(session)
        self.images.image = beside(
            depth_picture(loop.frames.image[0]), depth_picture(policy.reconstruction[0, 0])
        )
        true = session.env.scene[HEIGHT_MAP].data[0].numpy()
        self.maps.image = beside(map_picture(policy.height_map[0]), map_picture(true))
        self.loss.data = (times, scores, np.full(len(times), session.beta))
        self.trust.data = (times, probabilities, np.full(len(times), 0.5))

    def clear(self) -> None:
        """Forget the curves."""
        self._points.clear()


def status(session: ViewerSession) -> str:
    """Who drives, and why, as HTML."""
    loop = session.loop
    colour, driver = ("#d0453a", "OP · blind") if loop.use_op[0] else ("#4f9d4f", "VP · vision")
    reason = getattr(loop.selector, "reason", [""])[0]
    why = f"<br/>vision is not trusted: {reason}" if reason else ""
    return (
        '<div style="font-size:0.9em;line-height:1.4;padding:0 1em 0.5em 1em">'
        f'<b style="color:{colour}">{driver}</b> &nbsp; P_t {loop.selector.probability[0]:.2f}'
        f"<br/>loss {session.policy.anomaly_score[0]:.4f}, β {session.beta:.4f}"
        f"<br/>camera: {session.fault.replace('_', ' ') or 'healthy'}{why}</div>"
    )


def _curve(
    gui: viser.GuiApi, title: str, names: tuple[str, str], limits: tuple[float, float] | None = None
) -> viser.GuiUplotHandle:
    """A curve over time with a line to compare it with."""
    blue, grey = "#2f6fb0", "#9a9a9a"
    return gui.add_uplot(
        data=(np.zeros(1), np.zeros(1), np.zeros(1)),
        series=(
            viser.uplot.Series(label="s"),
            viser.uplot.Series(label=names[0], stroke=blue, width=2),
            viser.uplot.Series(label=names[1], stroke=grey, width=1),
        ),
        title=title,
        scales={
            "x": viser.uplot.Scale(time=False, auto=True),
            "y": viser.uplot.Scale(auto=True)
            if limits is None
            else viser.uplot.Scale(auto=False, min=limits[0], max=limits[1]),
        },
        aspect=2.4,
    )
