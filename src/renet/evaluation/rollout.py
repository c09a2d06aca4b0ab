"""Closed-loop runs: robots, camera faults, policy and selector, all settings side by side.

Every robot of every setting is one row of one batched world, so a whole study costs one run.
One control step goes as on the robot: the newest frame is taken at the 10 Hz tick, the policy acts
under the modality the selector last chose, then the selector's filter is updated
(200 Hz, paper) with the anomaly score the tick produced.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from renet.errors import RenetError
from renet.evaluation.trace import UPDATES_PER_STEP, Film, Trace
from renet.faults import TICK, Frames, Injector, Schedule, View
from renet.interface import CONTROL_DT, PHYSICS_DT, STEPS_PER_TICK
from renet.selector.monitors import SelectorInput

__all__ = ["MODES", "UPDATES_PER_STEP", "Controller", "Film", "Readings", "Row", "Switch", "Trace"]
__all__ += ["World", "check_modes", "check_speed", "run_rollout"]

MODES = ("vp", "renet", "op", "oracle-switch")
"""Policy modes: vision always, the selector's choice, never, and a switch that knows the fault."""


@dataclass(frozen=True)
class Readings:
    """What N robots sense and truly do after a control step."""

    proprioception: np.ndarray
    """[N, 45]"""
    depth: np.ndarray
    """[N, 48, 64] normalised, held between the camera's ticks."""
    angular_velocity: np.ndarray
    """[N, 3] true base rate, rad/s, base frame."""
    forward_velocity: np.ndarray
    """[N] true base velocity along the commanded yaw, m/s."""
    height: np.ndarray
    """[N] true height of the base above the ground it started on, m."""
    travelled: np.ndarray
    """[N] true horizontal distance from the start, m."""
    collisions: np.ndarray
    """[N] thighs, calves and trunks that touch something."""
    fell: np.ndarray
    """[N] bool: the episode ended in this step by a fall, judged by the true pose."""
    ended: np.ndarray
    """[N] bool: the episode ended in this step, by a fall or its time; the robot starts anew."""


class World(Protocol):
    """A batch of simulated robots; see `Disturbed` for physical faults."""

    num_robots: int

    def reset(self) -> Readings:
        """Put every robot at its start."""
        ...

    def step(self, action: np.ndarray) -> Readings:
        """Act [N, 12] for one control step."""
        ...

    def poses(self, rows: Sequence[int]) -> np.ndarray:
        """Generalised positions [len(rows), nq], for pictures."""
        ...


@runtime_checkable
class Disturbed(Protocol):
    """A world whose cameras can be made to see what is not there."""

    def disturb(self, view: View) -> None:
        """Let the cameras see the scene so from their next image on."""
        ...


class Controller(Protocol):
    """Anybody's policy: `renet.deploy.policy.Policy` is one.

    One with two velocity estimates, `velocity_op` and `velocity_vp` ([N, 3] m/s), has them compared
    by the selector's monitors.
    """

    anomaly_score: np.ndarray
    """[N] how unlike its training images the last frames were; any scale."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the past of the masked robots [N], of all by default."""
        ...

    def step(
        self, proprioception: np.ndarray, depth: np.ndarray, op_mask: np.ndarray
    ) -> np.ndarray:
        """Actions [N, 12]; `op_mask` is the paper's mask, True where OP is to act."""
        ...


class Switch(Protocol):
    """Decides whether to trust vision."""

    @property
    def probability(self) -> np.ndarray:
        """[N] vision probability P_t."""
        ...

    def update(self, sight: SelectorInput) -> np.ndarray:
        """One filter update; returns [N] bool, vision is trusted."""
        ...

    def reset(self, mask: np.ndarray) -> None:
        """Start anew for the masked robots [N]."""
        ...


@dataclass(frozen=True)
class Row:
    """One robot of one setting."""

    mode: str
    schedule: Schedule = ()
    robot: int = 0
    """Number within its setting; robots of the same number are twins that draw the same noise."""

    def __post_init__(self) -> None:
        check_modes((self.mode,))


def check_modes(modes: Sequence[str]) -> None:
    """Raise RenetError where there is no mode, or one that is unknown."""
    unknown = [mode for mode in modes if mode not in MODES]
    if unknown or not modes:
        said = f"unknown mode '{unknown[0]}'" if unknown else "no mode given"
        raise RenetError(f"{said}: choose among {', '.join(MODES)}")


def check_speed(speed: float) -> None:
    """Raise RenetError unless robots are told to walk, `speed` m/s."""
    if not speed > 0:
        raise RenetError(f"speed must be positive, got {speed}")


def run_rollout(
    world: World,
    controller: Controller,
    switch: Switch,
    rows: Sequence[Row],
    steps: int,
    seed: int,
    film: Sequence[int] = (),
    on_step: Callable[[], Any] = lambda: None,
    injector: Injector | None = None,
    on_sight: Callable[[SelectorInput], Any] = lambda sight: None,
) -> Trace:
    """Drive every row for a number of control steps.

    Args:
        world: as many robots as rows.
        controller: acts for all of them.
        switch: the selector; only rows in mode `renet` obey it.
        rows: mode and camera faults of each robot.
        steps: control steps.
        seed: of the camera faults.
        film: rows to keep poses and images of.
        on_step: called after every control step, as for a progress bar; the run ends early where it
            returns True.
        injector: of camera faults that depend on more than time; made from the rows by default.
        on_sight: shown what every update of the selector is, before it.

    Raises:
        RenetError: the world does not hold as many robots as there are rows, or cannot carry out a
            physical fault.
    """
    count = len(rows)
    if world.num_robots != count:
        raise RenetError(f"{count} rows need as many robots, not {world.num_robots}")
    if injector is None:
        injector = Injector(
            [row.schedule for row in rows],
            [row.robot for row in rows],
            seed,
            physical=isinstance(world, Disturbed),
        )
    disturbed = world if isinstance(world, Disturbed) else None
    mode = np.array([row.mode for row in rows])
    trace = Trace.empty(steps, count)
    poses, images = [], []
    if disturbed:
        disturbed.disturb(injector.view(0))
    readings = world.reset()
    controller.reset()
    frames = Frames.healthy(readings.depth)
    trusted = np.ones(count, bool)
    for k in range(steps):
        if k % STEPS_PER_TICK == 0:
            live = Frames.healthy(readings.depth, readings.angular_velocity)
            frames = injector.apply(live, k)
            if film:
                images.append(np.round(frames.image[list(film)] * 255).astype(np.uint8))
        failing = injector.at_work(k)
        use_op = (
            (mode == "op") | ((mode == "renet") & ~trusted) | ((mode == "oracle-switch") & failing)
        )
        action = controller.step(readings.proprioception, frames.image, use_op)
        for u in range(UPDATES_PER_STEP):
            sight = seen(controller, frames, k, u)
            on_sight(sight)
            trusted = switch.update(sight)
            trace.trusted[k, u] = trusted
        trace.anomaly[k], trace.probability[k] = controller.anomaly_score, switch.probability
        trace.vision[k], trace.failing[k] = ~use_op, failing
        if film:
            poses.append(world.poses(film))
        if disturbed:
            disturbed.disturb(injector.view(k + 1))
        readings = world.step(action)
        for name in ("forward_velocity", "height", "travelled", "collisions", "fell", "ended"):
            getattr(trace, name)[k] = getattr(readings, name)
        if readings.ended.any():
            controller.reset(readings.ended)
            switch.reset(readings.ended)
            trusted = trusted | readings.ended
        if on_step() is True:
            trace = trace.until(k + 1)
            break
    if film:
        trace.film = Film(tuple(film), np.stack(poses), np.stack(images))
    return trace


def seen(controller: Controller, frames: Frames, step: int, update: int) -> SelectorInput:
    """What a selector's update is shown: only the tick's first update has a new frame."""
    ticks = step % STEPS_PER_TICK
    passed = ticks * CONTROL_DT + update * PHYSICS_DT
    assert passed < TICK
    nothing = np.zeros((len(frames.age), 3))
    return SelectorInput(
        anomaly_score=controller.anomaly_score,
        image=frames.image,
        fresh=frames.fresh if passed == 0.0 else np.zeros_like(frames.fresh),
        age=frames.age + passed,
        invalid=frames.invalid,
        velocity_op=getattr(controller, "velocity_op", nothing),
        velocity_vp=getattr(controller, "velocity_vp", nothing),
    )
