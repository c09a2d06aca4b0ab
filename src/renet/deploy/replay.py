"""Fly a flight again: the logged inputs through the same controller, vision thread and all."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from renet.deploy.bundle import Bundle
from renet.deploy.cameras.base import DepthFrame
from renet.deploy.controller import Controller, Decision
from renet.deploy.flight_log import GOOD, NONE, READING, Flight
from renet.deploy.operator import Request
from renet.deploy.perception import InlinePerception
from renet.deploy.robots.base import RobotState
from renet.deploy.runner import REFUSED
from renet.deploy.safety import SafetyCfg
from renet.errors import RenetError
from renet.interface import DEPTH_SHAPE

UNREADABLE = np.full(DEPTH_SHAPE, np.nan, np.float32)


class ScriptedPerception(InlinePerception):
    """Gives each tick's result at the control step at which the flight's thread gave it."""

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
        return super().take() if row["perceived"] and not row["fallback"] else None


def replay(flight: Flight, bundle: Bundle) -> Iterator[Decision]:
    """What the controller decides at each tick of a flight, given the same inputs.

    Raises:
        RenetError: the flight was made with another bundle, or its log does not say with which
        limits.
    """
    made_with = flight.header.get("bundle_sha256")
    if made_with != bundle.sha256:
        raise RenetError(
            f"the flight was made with bundle {str(made_with)[:12]}, not {bundle.sha256[:12]}"
        )
    perception = ScriptedPerception(bundle.sessions, flight.ticks)
    try:
        safety, paper = SafetyCfg(**flight.header["safety"]), flight.header["paper_selector"]
    except (KeyError, TypeError) as error:
        raise RenetError(f"the log's header does not say how it was flown: {error}") from error
    controller = Controller(bundle, safety, perception, paper)
    image = UNREADABLE
    # The only thing that came from outside the controller's inputs.
    refused = {event.time for event in flight.events if event.why.startswith(REFUSED)}
    for step, tick in enumerate(flight.ticks):
        perception.step = step
        image = flight.images.get(step, image)
        request = Request(*(tick[name].item() for name in ("speed", "turn", "arm", "stop")))
        controller.tick(_state(tick), _frame(tick, image), request, float(tick["now"]))
        yield controller.decision
        if float(tick["now"]) in refused:
            controller.trip(REFUSED, float(tick["now"]))


def mismatch(flight: Flight, bundle: Bundle) -> float:
    """Largest difference between logged and replayed joint targets, rad; zero is a true replay."""
    worst = 0.0
    for tick, decision in zip(flight.ticks, replay(flight, bundle), strict=True):
        worst = max(worst, float(np.abs(tick["position"] - decision.command.position).max()))
    return worst


def _state(tick: np.ndarray) -> RobotState | None:
    if tick["state"] == NONE:
        return None
    return RobotState(float(tick["state_time"]), **{name: tick[name] for name, _, _ in READING})


def _frame(tick: np.ndarray, image: np.ndarray) -> DepthFrame | None:
    if tick["frame"] == NONE:
        return None
    image = image if tick["frame"] == GOOD else UNREADABLE
    number, time, invalid = (
        tick[name].item() for name in ("frame_number", "frame_time", "frame_invalid")
    )
    return DepthFrame(image, number, time, invalid)
