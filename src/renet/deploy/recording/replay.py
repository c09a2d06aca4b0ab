"""Replays a run: the recorded inputs through the same controller, vision thread and all."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from renet.bundle import Bundle
from renet.deploy.cameras.base import Camera, DepthFrame
from renet.deploy.controller import Controller, Decision
from renet.deploy.recording.reader import Recording
from renet.deploy.recording.tick import GOOD, NONE, WISHES
from renet.deploy.robots.base import VECTORS, RobotState
from renet.deploy.safety.limits import SafetyCfg
from renet.deploy.safety.machine import EXHAUSTED, REFUSED
from renet.deploy.teleop import TeleopCommand
from renet.errors import RenetError
from renet.interface import DEPTH_SHAPE
from renet.pilot.inference import InlineInference
from renet.pilot.reach import UNSEEN

UNREADABLE = np.full(DEPTH_SHAPE, np.nan, np.float32)


class ScriptedInference(InlineInference):
    """Gives each tick's result at the control step at which the run's thread gave it."""

    def __init__(self, sessions, ticks: np.ndarray) -> None:
        super().__init__(sessions)
        self._ticks = ticks
        self.step = 0

    def ready(self) -> bool:
        """Whether the thread was ready then."""
        return not self._ticks["fallback"][self.step]

    def take(self):
        """The result, if it was ready then."""
        row = self._ticks[self.step]
        return super().take() if row["inferred"] and not row["fallback"] else None


def replay(run: Recording, bundle: Bundle) -> Iterator[Decision]:
    """What the controller decides at each tick of a run, given the same inputs.

    Raises:
        RenetError: the run was made with another bundle, or its log lacks limits or mode.
    """
    made_with = run.header.get("bundle_sha256")
    if made_with != bundle.sha256:
        raise RenetError(
            f"the run was made with bundle {str(made_with)[:12]}, not {bundle.sha256[:12]}"
        )
    inference = ScriptedInference(bundle.sessions, run.ticks)
    try:
        safety = SafetyCfg(**run.header["safety"])
        mode = run.header["mode"]
    except (KeyError, TypeError) as error:
        raise RenetError(f"the recording's header does not say what ran: {error}") from error
    # Earlier recordings do not say it: their robots could only walk on.
    unseen = run.header.get("unseen", "walk")
    if unseen not in UNSEEN:
        raise RenetError(f"the recording's header has unseen {unseen!r}: {', '.join(UNSEEN)}")
    controller = Controller(bundle, safety, lambda sessions: inference, mode, unseen=unseen)
    image = UNREADABLE
    # What came from outside the controller's inputs.
    outside = (REFUSED, EXHAUSTED)
    tripped = {e.time: e.why for e in run.events if e.why.startswith(outside)}
    for step, tick in enumerate(run.ticks):
        inference.step = step
        image = run.images.get(step, image)
        teleop = TeleopCommand(*tick[[*WISHES]].item())
        controller.tick(_state(tick), _frame(tick, image), teleop, float(tick["now"]))
        yield controller.decision
        if float(tick["now"]) in tripped:
            controller.trip(tripped[float(tick["now"])], float(tick["now"]))


def mismatch(run: Recording, bundle: Bundle) -> float:
    """Largest difference between logged and replayed joint targets, rad; zero is a true replay."""
    worst = 0.0
    for tick, decision in zip(run.ticks, replay(run, bundle), strict=True):
        apart = np.abs(tick["position"] - decision.command.position).max()
        worst = float(np.maximum(worst, apart))  # NaN where one of both is.
    return worst


def _state(tick: np.ndarray) -> RobotState | None:
    if tick["state"] == NONE:
        return None
    values: dict[str, Any] = {name: tick[name] for name in VECTORS}
    return RobotState(float(tick["state_time"]), **values)


def _frame(tick: np.ndarray, image: np.ndarray) -> DepthFrame | None:
    if tick["frame"] == NONE:
        return None
    image = image if tick["frame"] == GOOD else UNREADABLE
    return DepthFrame(image, *tick[["frame_number", "frame_time", "frame_invalid"]].item())


class ReplayCamera(Camera):
    """Gives each image as long after `start` as it came after the run's first; keeps the last."""

    def __init__(self, run: Recording, now: Callable[[], float]) -> None:
        """Set up to show a run by the robot's clock `now`; raises RenetError without images."""
        if not run.images:
            raise RenetError("the recording holds no images: it was made without a camera")
        self._run, self._now, self._begun = run, now, math.inf
        self._rows = sorted(run.images)
        times = run.ticks["now"][self._rows]
        self._times = times - times[0]

    def start(self) -> None:
        """The first image is shown now."""
        self._begun = self._now()

    def latest(self) -> DepthFrame | None:
        """Newest frame; None before the first."""
        since = self._now() - self._begun
        newest = int(np.searchsorted(self._times, since + 1e-6, side="right")) - 1
        if newest < 0:
            return None
        row, time = self._rows[newest], self._begun + float(self._times[newest])
        number, invalid = self._run.ticks[row][["frame_number", "frame_invalid"]].item()
        return DepthFrame(self._run.images[row], number, time, invalid)
