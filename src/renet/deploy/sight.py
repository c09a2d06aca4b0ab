"""From camera frames to what policy and selector get: the newest good image, and whether to trust.

A frame that is malformed, or no newer than the last, is as good as none: the image before it stays
and grows old, and the selector gives vision up. Nothing here ever raises.
"""

from __future__ import annotations

import math

import numpy as np

from renet.deploy.cameras.base import DepthFrame
from renet.deploy.manifest import SelectorSpec
from renet.deploy.policy import Policy
from renet.errors import RenetError
from renet.interface import CONTROL_DT, DEPTH_SHAPE
from renet.selector.defaults import default_monitors
from renet.selector.guard import GuardCfg, GuardedSelector
from renet.selector.monitors import Reconstruction, Sight
from renet.selector.selector import Selector, SelectorCfg

FUTURE = 0.05
"""Seconds by which a frame's time may run ahead of the robot's clock."""
OLDEST = 1e3
"""Age in seconds of a frame that never came."""


class FrameKeeper:
    """Keeps the newest good image."""

    def __init__(self) -> None:
        self.image: np.ndarray | None = None
        """[48, 64] float32, rounded as in training; None before the first good frame."""
        self.invalid = 0.0
        self.problem = ""
        """What was wrong with the last frame offered; empty if nothing was."""
        self._time = -math.inf
        self._fresh = False

    def offer(self, frame: DepthFrame | None, now: float) -> None:
        """Look at what the camera has; called at every control tick."""
        self.problem = ""
        if frame is None:
            return
        try:
            image, time = clean_frame(frame, now)
        except RenetError as error:
            self.problem = str(error)
            return
        if time <= self._time:
            return  # The same frame again, or one that arrived out of order.
        self.image, self._time, self._fresh = image, time, True
        self.invalid = float(frame.invalid)

    def age(self, now: float) -> float:
        """Seconds since the image was taken."""
        return min(max(now - self._time, 0.0), OLDEST)

    def take(self) -> tuple[np.ndarray | None, bool]:
        """The image for a vision tick, and whether it is new since the last one."""
        fresh, self._fresh = self._fresh, False
        return self.image, fresh


def clean_frame(frame: DepthFrame, now: float) -> tuple[np.ndarray, float]:
    """Image [48, 64] float32 and time of a frame; raises RenetError naming what is wrong.

    Images are rounded to half precision, in which training saw them.
    """
    try:
        shape = np.shape(frame.image)
        if shape != DEPTH_SHAPE:
            raise RenetError(f"the depth image has shape {shape}, expected {DEPTH_SHAPE}")
        with np.errstate(over="ignore"):
            image = np.asarray(frame.image, np.float16).astype(np.float32)
        time, invalid = float(frame.time), float(frame.invalid)
        int(frame.number)
    except RenetError:
        raise
    except Exception as error:  # A driver's object may fail in any way.
        raise RenetError("the depth frame is none, or not made of numbers") from error
    if not np.isfinite(image).all():
        raise RenetError("the depth image is not finite")
    if image.min() < 0.0 or image.max() > 1.0:
        raise RenetError("the depth image leaves [0, 1]")
    if not (math.isfinite(time) and 0.0 <= invalid <= 1.0):
        raise RenetError("the depth frame's time or invalid share cannot be right")
    if time > now + FUTURE:
        raise RenetError("the depth frame's time lies in the future")
    return image, time


class Trust:
    """Whether one robot trusts vision: the selector behind `FrameKeeper`."""

    def __init__(self, spec: SelectorSpec, paper: bool = False) -> None:
        """Set up.

        Args:
            spec: of the bundle. paper: use the paper's selector alone, without the monitors.
        """
        self._updates = max(1, round(CONTROL_DT * spec.rate_hz))
        self._paper = Selector(SelectorCfg(spec.beta, spec.gamma, spec.rate_hz)) if paper else None
        monitors = default_monitors(spec.beta, spec.thresholds, 1)
        self._guard = GuardedSelector(monitors, 1, GuardCfg(spec.gamma, spec.rate_hz))
        self.vision = True
        """The newest verdict."""

    @property
    def probability(self) -> float:
        """Vision probability P_t."""
        return float((self._paper or self._guard).probability[0])

    @property
    def reason(self) -> str:
        """Why vision was given up; empty while it is trusted."""
        if self.vision:
            return ""
        return Reconstruction.reason if self._paper else str(self._guard.reason[0])

    def reset(self) -> None:
        """Trust vision, forget the past."""
        everybody = np.ones(1, bool)
        self._guard.reset(everybody)
        if self._paper is not None:
            self._paper.reset()
        self.vision = True

    def update(
        self, policy: Policy, keeper: FrameKeeper, image: np.ndarray, fresh: bool, age: float
    ) -> bool:
        """All filter updates of one control period; returns "use vision" for the next.

        Args:
            policy: whose scores and velocities are judged.
            keeper: what is known of the newest raw frame.
            image: [1, 48, 64] last given to the policy, a new array whenever one is.
            fresh: it was given in this period.
            age: of the newest frame, s.
        """
        score = np.array([np.inf]) if keeper.problem else policy.anomaly_score
        for update in range(self._updates):
            if self._paper is not None:
                verdict = self._paper.update(score)
            else:
                passed = update * CONTROL_DT / self._updates
                verdict = self._guard.update(
                    Sight(
                        anomaly_score=score,
                        image=image,
                        fresh=np.array([fresh and update == 0]),
                        age=np.array([age + passed]),
                        invalid=np.array([keeper.invalid]),
                        velocity_op=policy.velocity_op,
                        velocity_vp=policy.velocity_vp,
                    )
                )
            self.vision = bool(verdict[0])
        return self.vision
