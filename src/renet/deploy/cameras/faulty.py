"""Camera with injected faults: fault models between any camera and the controller."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from renet.deploy.cameras.base import Camera, DepthFrame, next_due
from renet.deploy.robots.base import RobotState, all_finite
from renet.faults import Frames, Injection, Injector, ViewPerturbation
from renet.interface import CONTROL_DT, TICK_DT, control_steps


class FaultyCamera(Camera):
    """Passes a camera's frames, at most ten a second, through a fault injector.

    Faults of the image spoil it, delay it or leave holes. Faults of the scene (foam, glass, a mount
    that is knocked or gives way) need a simulated camera. Onsets count from the first call of
    `latest`.
    """

    def __init__(
        self,
        camera: Camera,
        faults: Sequence[Injection],
        now: Callable[[], float],
        seed: int,
        read: Callable[[], RobotState | None] = lambda: None,
    ) -> None:
        """Wrap a camera.

        Args:
            camera: Camera with frames to spoil.
            faults: Faults, which act on the same frames one after the other.
            now: Function that returns the time on the robot's clock, s.
            seed: Seed of the faults' randomness.
            read: Function that returns the robot's newest reading, whose turn rate blurs images; by
                default the robot does not turn.

        Raises:
            RenetError: This camera or its scene cannot have one of the faults.
        """
        self._camera = camera
        self._now = now
        self._read = read
        self._perturb = getattr(camera, "perturb", None)
        """Method by which a simulated camera shows a changed scene; None for a real one."""
        self._injector = Injector([tuple(faults)], [0], seed, self._perturb is not None)
        if self._perturb is not None:
            # A fault that the scene cannot have is refused now rather than while walking.
            for fault in faults:
                self._perturb(self._injector.perturbation(fault.onset))
            self._perturb(ViewPerturbation.none(1))
        self._begun: float | None = None
        self._due = float("-inf")
        """Time from which the next frame is passed on, s."""
        self._shown: DepthFrame | None = None

    def start(self) -> None:
        """Begin to stream; raises RenetError with what to do when that fails."""
        self._camera.start()

    def latest(self) -> DepthFrame | None:
        """Return the newest frame; None before the first."""
        now = self._now()
        self._begun = now if self._begun is None else self._begun
        if self._perturb is not None:
            self._perturb(self._injector.perturbation(self._step(now)))
        self._camera.busy = self.busy
        frame = self._camera.latest()
        # Fault models are made for 10 Hz: frames of a faster camera are thinned out.
        if frame is None or frame.time < self._due - CONTROL_DT / 2:
            return self._shown
        self._due = next_due(self._due, frame.time, TICK_DT)
        healthy = Frames.healthy(frame.image[None], self._turn_rate())
        healthy = replace(healthy, invalid=np.array([frame.invalid]))
        spoilt = self._injector.apply(healthy, self._step(frame.time))
        # A fault that holds frames back leaves the one before.
        if spoilt.fresh[0]:
            self._shown = replace(
                frame,
                image=spoilt.image[0],
                time=frame.time - float(spoilt.age[0]),
                invalid=float(spoilt.invalid[0]),
            )
        return self._shown

    @property
    def problem(self) -> str:
        """Problem that the wrapped camera reports; empty if there is none."""
        return getattr(self._camera, "problem", "")

    def close(self) -> None:
        """Stop streaming; a second call does nothing."""
        self._camera.close()

    def _turn_rate(self) -> np.ndarray:
        """Return the angular velocity of the base, [1, 3] rad/s; zeros without a sound reading."""
        state = self._read()
        if state is None or not all_finite(state.angular_velocity):
            return np.zeros((1, 3))
        return state.angular_velocity[None]

    def _step(self, time: float) -> int:
        """Return the number of control steps from the first call of `latest` to a time, s."""
        return max(control_steps(time - (self._begun or 0.0)), 0)
