"""Any camera with something wrong with it: fault models between the camera and the controller."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from renet.deploy.cameras.base import Camera, DepthFrame
from renet.faults import Frames, Injection, Injector, ViewPerturbation
from renet.interface import CONTROL_DT, TICK_DT


class FaultyCamera(Camera):
    """Passes a camera's frames, at most ten a second, through a fault injector.

    Faults spoil images, hold them back or leave holes; those of the scene (foam, glass, a mount
    that is knocked or gives way) need a simulated camera. Onsets count from the first look.
    """

    def __init__(
        self, camera: Camera, faults: Sequence[Injection], now: Callable[[], float], seed: int
    ) -> None:
        """Wrap a camera; raises RenetError for a fault that it or its scene cannot have.

        The faults act one after the other on the same frames; `now` is the robot's clock, s.
        """
        self._camera, self._now = camera, now
        self._perturb = getattr(camera, "perturb", None)
        """The method by which a simulated camera shows a wrong scene; None: it has none."""
        self._injector = Injector([tuple(faults)], [0], seed, self._perturb is not None)
        if self._perturb is not None:
            for fault in faults:  # Refused now rather than while walking.
                self._perturb(self._injector.perturbation(fault.onset))
            self._perturb(ViewPerturbation.none(1))
        self._begun: float | None = None
        self._due = float("-inf")
        self._shown: DepthFrame | None = None

    def start(self) -> None:
        """Begin to stream; raises RenetError with what to do when that fails."""
        self._camera.start()

    def latest(self) -> DepthFrame | None:
        """Newest frame; None before the first."""
        now = self._now()
        self._begun = now if self._begun is None else self._begun
        if self._perturb is not None:
            self._perturb(self._injector.perturbation(self._step(now)))
        self._camera.busy = self.busy
        frame = self._camera.latest()
        # Fault models know frames at 10 Hz; a faster camera is thinned out.
        if frame is None or frame.time < self._due - CONTROL_DT / 2:
            return self._shown
        self._due = max(self._due + TICK_DT, frame.time)
        healthy = Frames.healthy(frame.image[None])
        spoilt = self._injector.apply(healthy, self._step(frame.time))
        if spoilt.fresh[0]:
            self._shown = replace(
                frame,
                image=spoilt.image[0],
                time=frame.time - float(spoilt.age[0]),
                invalid=max(frame.invalid, float(spoilt.invalid[0])),
            )
        return self._shown

    @property
    def problem(self) -> str:
        """What the camera itself complains of."""
        return getattr(self._camera, "problem", "")

    def close(self) -> None:
        """Stop streaming; safe to call twice."""
        self._camera.close()

    def _step(self, time: float) -> int:
        """Control steps since the first look."""
        return max(round((time - (self._begun or 0.0)) / CONTROL_DT), 0)
