"""Replay of a run: the recorded inputs through the same controller, as its threads were timed."""

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
from renet.deploy.teleop.base import TeleopCommand
from renet.errors import RenetError
from renet.interface import DEPTH_SHAPE
from renet.pilot.inference import InlineInference

_UNREADABLE = np.full(DEPTH_SHAPE, np.nan, np.float32)
"""Image in place of one that was malformed, which the controller refuses, too."""


class ScriptedInference(InlineInference):
    """Returns each vision result at the control step at which the run's thread returned it."""

    def __init__(self, sessions, ticks: np.ndarray) -> None:
        super().__init__(sessions)
        self._ticks = ticks
        self.step = 0
        """Row of the control tick that is replayed."""

    def ready(self) -> bool:
        """Return True if the thread of the run was ready at this step."""
        return not self._ticks["fallback"][self.step]

    def take(self):
        """Return the result of the vision tick; None if the run took none at this step."""
        row = self._ticks[self.step]
        return super().take() if row["inferred"] and not row["fallback"] else None


def replay_run(run: Recording, bundle: Bundle) -> Iterator[Decision]:
    """Yield the controller's decision at each tick of a run, given the same inputs.

    Raises:
        RenetError: The run was made with another bundle, or its header lacks limits or mode.
    """
    controller, inference = _controller(run, bundle)
    image = _UNREADABLE
    # Reasons for damping that did not come from the controller's inputs.
    outside = (REFUSED, EXHAUSTED)
    tripped = {event.time: event.why for event in run.events if event.why.startswith(outside)}
    for step, tick in enumerate(run.ticks):
        inference.step = step
        now = float(tick["now"])
        image = run.images.get(step, image)
        teleop = TeleopCommand(*tick[[*WISHES]].item())
        controller.tick(_state(tick), _frame(tick, image), teleop, now)
        yield controller.decision
        if now in tripped:
            controller.trip(tripped[now], now)


def _controller(run: Recording, bundle: Bundle) -> tuple[Controller, ScriptedInference]:
    """Make the controller of a run, and its vision; raises RenetError as `replay_run`."""
    made_with = run.header.get("bundle_sha256")
    if made_with != bundle.sha256:
        raise RenetError(
            f"the run was made with bundle {str(made_with)[:12]}, not {bundle.sha256[:12]}"
        )
    inference = ScriptedInference(bundle.sessions, run.ticks)
    try:
        safety = SafetyCfg(**run.header["safety"])
        mode = run.header["mode"]
        unseen = run.header["unseen"]
    except (KeyError, TypeError) as error:
        raise RenetError(f"the recording's header does not say what ran: {error}") from error
    dry_run = run.header.get("dry_run", False)
    controller = Controller(
        bundle, safety, lambda sessions: inference, mode, unseen=unseen, dry_run=dry_run
    )
    return controller, inference


def replay_error(run: Recording, bundle: Bundle) -> float:
    """Return the largest difference between recorded and replayed joint targets, rad."""
    worst = 0.0
    for tick, decision in zip(run.ticks, replay_run(run, bundle), strict=True):
        apart = np.abs(tick["position"] - decision.command.position).max()
        # NaN if either is.
        worst = float(np.maximum(worst, apart))
    return worst


def _state(tick: np.ndarray) -> RobotState | None:
    """Return the reading of a recorded tick; None if there was none."""
    if tick["state"] == NONE:
        return None
    values: dict[str, Any] = {name: tick[name] for name in VECTORS}
    return RobotState(float(tick["state_time"]), **values)


def _frame(tick: np.ndarray, image: np.ndarray) -> DepthFrame | None:
    """Return the depth frame of a recorded tick, given the newest image; None if there was none."""
    if tick["frame"] == NONE:
        return None
    image = image if tick["frame"] == GOOD else _UNREADABLE
    return DepthFrame(image, *tick[["frame_number", "frame_time", "frame_invalid"]].item())


class ReplayCamera(Camera):
    """Shows each image of a run as long after `start` as it came after the first one.

    The last image stays.
    """

    def __init__(self, run: Recording, now: Callable[[], float]) -> None:
        """Set up without showing an image.

        Args:
            run: Run with the images to show.
            now: Function that returns the time on the robot's clock, s.

        Raises:
            RenetError: The run has no images.
        """
        if not run.images:
            raise RenetError("the recording holds no images: it was made without a camera")
        self._run = run
        self._now = now
        self._begun = math.inf
        self._rows = sorted(run.images)
        times = run.ticks["now"][self._rows]
        self._times = times - times[0]

    def start(self) -> None:
        """Begin to stream: the first image is shown now."""
        self._begun = self._now()

    def latest(self) -> DepthFrame | None:
        """Return the newest frame; None before the first."""
        since = self._now() - self._begun
        # The small number makes up for the rounding of clocks.
        newest = int(np.searchsorted(self._times, since + 1e-6, side="right")) - 1
        if newest < 0:
            return None
        row = self._rows[newest]
        time = self._begun + float(self._times[newest])
        number, invalid = self._run.ticks[row][["frame_number", "frame_invalid"]].item()
        return DepthFrame(self._run.images[row], number, time, invalid)
