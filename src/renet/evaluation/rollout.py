"""Closed-loop runs: robots, camera faults, policy and selector, all settings side by side.

Every robot of every setting is one row of one batched environment, so a whole study costs one run.
One control step goes as on the robot: the newest frame is taken at the 10 Hz tick, the policy acts
under the modality the selector last chose, then the selector's filter is updated
(200 Hz, paper) with the anomaly score the tick produced.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol

import numpy as np

from renet.errors import RenetError
from renet.evaluation.trace import UPDATES_PER_STEP, Film, Trace, TrueState
from renet.faults import Frames, Injector, Schedule, ViewPerturbation
from renet.interface import CONTROL_DT, PHYSICS_DT, STEPS_PER_TICK
from renet.selector.monitors import Gate, SelectorInput
from renet.terminal import progress
from renet.terrain.tiles import find_tile

FLAT, PARKOUR = "flat", "parkour"
"""Ground without tiles, and a field of all tiles at all levels."""
POLICY_MODES = ("vp", "renet", "op", "paper", "oracle-switch")
"""Policy modes: vision always, the selector's choice, never, the choice of the paper's selector,
and a switch that knows the fault."""


@dataclass(frozen=True)
class StepResult(TrueState):
    """What N robots sense and truly do after a control step."""

    proprioception: np.ndarray
    """[N, 45]"""
    depth: np.ndarray
    """[N, 48, 64] normalised, held between the camera's ticks."""
    angular_velocity: np.ndarray
    """[N, 3] true base rate, rad/s, base frame."""


class EvalEnv(Protocol):
    """A batch of simulated robots."""

    num_robots: int

    def reset(self) -> StepResult:
        """Put every robot at its start."""
        ...

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step."""
        ...

    def poses(self, rows: Sequence[int]) -> np.ndarray:
        """Generalised positions [len(rows), nq], for pictures."""
        ...

    def perturb_cameras(self, view: ViewPerturbation) -> None:
        """Let the cameras see the scene so from their next image on: physical faults."""


class EvalPolicy(Protocol):
    """Anybody's policy: `renet.bundle.policy.Policy` is one.

    One with two velocity estimates, `velocity_op` and `velocity_vp` ([N, 3] m/s), has them compared
    by the selector's monitors. One with `variance_score` ([N]) has it judged likewise. One with
    `has_image` ([N] bool) can do without an image: its `step` takes a `gate`, too.
    """

    anomaly_score: np.ndarray
    """[N] how unlike its training images the last frames were; any scale."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the past of the masked robots [N], of all by default."""

    def step(
        self, proprioception: np.ndarray, depth: np.ndarray, op_mask: np.ndarray
    ) -> np.ndarray:
        """Actions [N, 12]; `op_mask` is the paper's mask, True where OP is to act."""
        ...


class EvalSelector(Protocol):
    """Decides whether to trust vision."""

    @property
    def probability(self) -> np.ndarray:
        """[N] vision probability P_t."""
        ...

    def look(self, seen: SelectorInput) -> Gate | None:
        """Once each tick, before the policy acts: which images it may use; None: all."""
        ...

    def update(self, seen: SelectorInput, now: float) -> np.ndarray:
        """Once each physics step, at `now` s; returns [N] bool, vision is trusted."""
        ...

    def reset(self, mask: np.ndarray) -> None:
        """Start anew for the masked robots [N]."""


@dataclass(frozen=True)
class Trial:
    """One robot of one setting."""

    mode: str
    schedule: Schedule = ()
    robot: int = 0
    """Number within its setting; robots of the same number are twins that draw the same noise."""
    ground: str = "flat"
    """Where it walks, in an environment of several grounds."""

    def __post_init__(self) -> None:
        check_modes((self.mode,))


def check_modes(modes: Sequence[str]) -> None:
    """Raise RenetError where there is no mode, or one that is unknown or given twice."""
    if not modes or not {*modes} <= {*POLICY_MODES} or len({*modes}) < len(modes):
        known = ", ".join(POLICY_MODES)
        raise RenetError(f"modes {', '.join(modes) or 'none'}: choose, once each, among {known}")


def check_grounds(levels: Mapping[str, int]) -> None:
    """Raise RenetError for a ground that is neither flat nor a kind of tile, or has no such level.

    Args:
        levels: level, 1 to 10, of each ground.
    """
    for ground, level in levels.items():
        find_tile("rough" if ground == FLAT else ground, level)


def check_speed(speed: float) -> None:
    """Raise RenetError unless robots are told to walk, `speed` m/s."""
    if not speed > 0:
        raise RenetError(f"speed must be positive, got {speed}")


def check_finite(settings: Any) -> None:
    """Raise RenetError naming a number of a dataclass that is infinite or none."""
    for name, value in vars(settings).items():
        if isinstance(value, float) and not np.isfinite(value):
            raise RenetError(f"{name.replace('_', ' ')} must be a finite number, got {value}")


@dataclass
class ClosedLoop:
    """Environment, policy, selector and camera faults of N robots, one control step at a time.

    Studies, calibration and films all run this loop. Call `reset` before the first step.
    """

    env: EvalEnv
    policy: EvalPolicy
    selector: EvalSelector
    """Only robots in mode `renet` obey it."""
    modes: np.ndarray
    """[N] policy mode of each robot."""
    injector: Injector
    """Of the camera faults."""
    on_update: Callable[[SelectorInput], Any] = lambda seen: None
    """Shown the input of every update of the selector, before it."""
    paper: EvalSelector | None = None
    """Only robots in mode `paper` obey it; None where there are none."""
    clock: int = field(default=0, init=False)
    """Control steps so far, over all resets: faults are scheduled by it."""

    def reset(self) -> StepResult:
        """Put every robot at its start, trusting vision."""
        self.env.perturb_cameras(self.injector.perturbation(self.clock))
        self.result = self.env.reset()
        self.policy.reset()
        count = self.env.num_robots
        for selector in self._selectors:
            selector.reset(np.ones(count, bool))
        self.frames = Frames.healthy(self.result.depth)
        self.trusted = np.ones(count, bool)
        """[N] bool: the selector's last answer."""
        self._steps = 0
        return self.result

    @property
    def _selectors(self) -> list[EvalSelector]:
        return [self.selector, *([self.paper] if self.paper else [])]

    @property
    def new_frame(self) -> bool:
        """Whether the camera delivers in the step that is due, as it does at 10 Hz."""
        return self._steps % STEPS_PER_TICK == 0

    def act(self) -> np.ndarray:
        """Actions [N, 12] for the step that is due; also updates the selector."""
        result, injector = self.result, self.injector
        if self.new_frame:
            live = Frames.healthy(result.depth, result.angular_velocity)
            self.frames = injector.apply(live, self.clock)
        self.failing = injector.at_work(self.clock)
        """[N] bool: the camera is failing."""
        distrusted = np.isin(self.modes, ("renet", "paper")) & ~self.trusted
        told = (self.modes == "oracle-switch") & self.failing
        self.use_op = (self.modes == "op") | distrusted | told
        """[N] bool: the OP estimator drives."""
        action = self.policy.step(
            result.proprioception, self.frames.image, self.use_op, **self._gate()
        )
        self.answers = np.zeros((UPDATES_PER_STEP, len(self.modes)), bool)
        """[U, N] bool: vision is trusted after each update of this step."""
        for update in range(UPDATES_PER_STEP):
            seen = selector_input(self.policy, self.frames, self._steps, update)
            self.on_update(seen)
            now = (self.clock * UPDATES_PER_STEP + update + 1) * PHYSICS_DT
            answers = [selector.update(seen, now) for selector in self._selectors]
            # With two selectors the last is the paper's.
            self.trusted = np.where(self.modes == "paper", answers[-1], answers[0])
            self.answers[update] = self.trusted
        self.clock += 1
        self._steps += 1
        self.env.perturb_cameras(self.injector.perturbation(self.clock))
        return action

    def _gate(self) -> dict[str, Gate]:
        """Which images robots in mode `renet` may use, as an argument of the policy's step."""
        if not self.new_frame:
            return {}
        seen = selector_input(self.policy, self.frames, self._steps, 0)
        gates = [selector.look(seen) for selector in self._selectors]
        if gates[0] is None or not hasattr(self.policy, "has_image"):
            return {}
        return {"gate": replace(gates[0], robots=self.modes == "renet")}

    @property
    def probability(self) -> np.ndarray:
        """[N] vision probability P_t of the selector that each robot obeys."""
        values = [selector.probability for selector in self._selectors]
        return np.where(self.modes == "paper", values[-1], values[0])

    def step(self, action: np.ndarray) -> StepResult:
        """Step the environment; policy and selector start anew for robots whose episode ended."""
        self.result = self.env.step(action)
        ended = self.result.ended
        if ended.any():
            self.policy.reset(ended)
            for selector in self._selectors:
                selector.reset(ended)
            self.trusted = self.trusted | ended
        return self.result


def run_rollout(
    env: EvalEnv,
    policy: EvalPolicy,
    selector: EvalSelector,
    trials: Sequence[Trial],
    steps: int,
    seed: int,
    film: Sequence[int] = (),
    on_step: Callable[[StepResult], Any] = lambda result: None,
    injector: Injector | None = None,
    on_update: Callable[[SelectorInput], Any] = lambda seen: None,
    title: str = "rollout",
    until_ended: int | None = None,
    paper: EvalSelector | None = None,
) -> Trace:
    """Run every trial for a number of control steps, beside a progress bar.

    Args:
        env: as many robots as trials.
        policy: acts for all of them.
        selector: only trials in mode `renet` obey it.
        trials: mode and camera faults of each robot.
        steps: control steps.
        seed: of the camera faults.
        film: trials to keep poses and images of.
        on_step: called after every control step; the run ends early where it returns True.
        injector: of camera faults that depend on more than time; made from the trials by default.
        on_update: shown the input of every update of the selector, before it.
        title: of the progress bar.
        until_ended: control steps after which the run ends once every robot's first try is over;
            None: it does not.
        paper: which trials in mode `paper` obey.

    Returns:
        What happened, [steps, N].

    Raises:
        RenetError: the environment does not hold as many robots as there are trials, or its scene
            cannot have one of the faults.
    """
    count = len(trials)
    if env.num_robots != count:
        raise RenetError(f"{count} trials need as many robots, not {env.num_robots}")
    if injector is None:
        schedules, streams = [t.schedule for t in trials], [t.robot for t in trials]
        injector = Injector(schedules, streams, seed, physical=True)
    modes = np.array([t.mode for t in trials])
    loop = ClosedLoop(env, policy, selector, modes, injector, on_update, paper)
    trace, chosen = Trace.empty(steps, count), list(film)
    poses, images = [], []
    loop.reset()
    for k in progress(range(steps), title):
        delivered = loop.new_frame
        action = loop.act()
        if film:
            poses.append(env.poses(film))
        if film and delivered:
            images.append(np.round(loop.frames.image[chosen] * 255).astype(np.uint8))
        trace.trusted[k] = loop.answers
        trace.anomaly[k], trace.probability[k] = policy.anomaly_score, loop.probability
        trace.has_image[k] = getattr(policy, "has_image", True)
        trace.map_error[k] = getattr(policy, "map_error", 0.0)
        trace.vision[k], trace.failing[k] = ~loop.use_op, loop.failing
        result = loop.step(action)
        for state in fields(TrueState):
            getattr(trace, state.name)[k] = getattr(result, state.name)
        due = until_ended is not None and k >= until_ended
        if on_step(result) is True or (due and trace.ended[: k + 1].any(axis=0).all()):
            trace = trace.until(k + 1)
            break
    if film:
        return replace(trace, film=Film(np.stack(poses), np.stack(images)))
    return trace


def selector_input(policy: EvalPolicy, frames: Frames, step: int, update: int) -> SelectorInput:
    """What a selector's update is shown: only the tick's first update has a new frame."""
    passed = step % STEPS_PER_TICK * CONTROL_DT + update * PHYSICS_DT
    nothing = np.zeros((len(frames.age), 3))
    none = np.zeros(len(frames.age))
    return SelectorInput(
        anomaly_score=policy.anomaly_score,
        variance_score=getattr(policy, "variance_score", none),
        image=frames.image,
        fresh=frames.fresh if passed == 0.0 else np.zeros_like(frames.fresh),
        age=frames.age + passed,
        invalid=frames.invalid,
        velocity_op=getattr(policy, "velocity_op", nothing),
        velocity_vp=getattr(policy, "velocity_vp", nothing),
        has_image=getattr(policy, "has_image", none == 0.0),
        map_error=getattr(policy, "map_error", none),
    )
