"""Closed-loop runs: robots, camera faults and a pilot, all settings side by side.

Every robot of every setting is one row of one batched environment, so that a whole study takes one
run. A control step is the same as on a real robot, except that the pilot judges its images at the
paper's 200 Hz, four times in a control step.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol

import numpy as np

from renet.errors import RenetError
from renet.evaluation.settings import FLAT_GROUND, ORACLE, check_modes
from renet.evaluation.trace import UPDATES_PER_STEP, Film, StepResult, Trace, TrueState
from renet.faults import FaultSchedule, Frames, Injector, ViewPerturbation
from renet.interface import CONTROL_DT, MAP_HEIGHT, PHYSICS_DT, STEPS_PER_TICK
from renet.pilot import Images, Pilot
from renet.pilot.policy import Policy
from renet.selector.monitors import SelectorInput
from renet.terminal import progress


@dataclass(frozen=True)
class Trial:
    """One robot of one setting."""

    mode: str
    """Policy mode, see `settings.StudyMode`."""
    schedule: FaultSchedule = ()
    """Faults of its camera; none by default."""
    robot: int = 0
    """Number within its setting; robots of the same number are twins that draw the same noise."""
    ground: str = FLAT_GROUND
    """Ground it walks on, in an environment of several grounds."""

    def __post_init__(self) -> None:
        check_modes((self.mode,))


class EvalEnv(Protocol):
    """A batch of N simulated robots.

    An environment may have a method `retire(mask)`, as `SimEnv` does, that saves the work for
    robots whose try is over, and a `map_height`, where its robots' is not `MAP_HEIGHT`.
    """

    num_robots: int
    """Number of robots, N."""

    def reset(self) -> StepResult:
        """Put every robot at its start, and simulate those again that were retired."""
        ...

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step."""
        ...

    def poses(self, rows: Sequence[int]) -> np.ndarray:
        """Return generalised positions [len(rows), nq], for pictures."""
        ...

    def perturb_cameras(self, view: ViewPerturbation) -> None:
        """Set how cameras see the scene from their next image on: physical faults."""


class Rollout:
    """A run of N robots, each with the policy mode and the camera faults of its trial."""

    def __init__(self, env: EvalEnv, pilot: Pilot, trials: Sequence[Trial], seed: int) -> None:
        """Prepare a run.

        Args:
            env: Environment of N robots.
            pilot: Pilot of N robots in the trials' modes (see `pilot_modes`).
            trials: Mode and camera faults of each robot, [N].
            seed: Seed of the camera faults.

        Raises:
            RenetError: The environment has another number of robots.
        """
        if env.num_robots != len(trials):
            raise RenetError(f"{len(trials)} trials need as many robots, not {env.num_robots}")
        self.env = env
        self.pilot = pilot
        self.modes = np.array([trial.mode for trial in trials])
        """Mode of each trial, [N]."""
        schedules = [trial.schedule for trial in trials]
        self.injector = Injector(schedules, robot_numbers(trials), seed, physical=True)
        self.on_update: Callable[[SelectorInput], Any] = lambda seen: None
        """Called with the input of every judgement of the pilot, before the pilot judges."""

    @property
    def policy(self) -> Policy:
        """The pilot's policy."""
        return self.pilot.policy

    def run(
        self,
        steps: int,
        title: str = "rollout",
        *,
        until_ended: int | None = None,
        retire: bool = False,
        film: Sequence[int] = (),
        on_step: Callable[[int], Any] = lambda step: None,
    ) -> Trace:
        """Run for a number of control steps; raises RenetError if the scene cannot have a fault.

        Args:
            steps: Number of control steps.
            title: Title of the progress.
            until_ended: Number of control steps after which the run ends as soon as every robot's
                first try is over; None: it always runs for `steps`.
            retire: True to stop simulating robots whose first try is over. The trace of a retired
                robot is meaningless from then on; the traces of the others stay the same, bit for
                bit.
            film: Robots to keep poses and images of.
            on_step: Called after every control step with its number, from 0; True ends the run.
        """
        trace = Trace.empty(steps, len(self.modes))
        # Step from which on the run may end early.
        least = steps - 1 if until_ended is None else until_ended
        poses: list[np.ndarray] = []
        images: list[np.ndarray] = []
        maps: list[np.ndarray] = []
        maps_seen: list[np.ndarray] = []
        self._reset()
        for step in progress(range(steps), title):
            action = self._act(step, trace)
            if film:
                poses.append(self.env.poses(film))
                # Images and maps change once in a vision tick.
                if step % STEPS_PER_TICK == 0:
                    shown = self._frames.image[list(film)]
                    images.append(np.round(shown * 255).astype(np.uint8))
                    height_map = getattr(self.policy, "height_map", None)
                    if height_map is not None:
                        maps.append(height_map[list(film)])
                        maps_seen.append(self.pilot.map_seen[list(film)])
            self._advance(action, step, trace)
            if retire and self._result.ended.any():
                self._retire()
            if on_step(step) is True:
                trace = trace.until(step + 1)
                break
            if self._over.all() and (retire or step >= least):
                trace = trace.until(max(step, least) + 1)
                break
        if not film:
            return trace
        arrays = (np.stack(poses), np.stack(images), np.array(maps), np.array(maps_seen))
        map_height = getattr(self.env, "map_height", MAP_HEIGHT)
        return replace(trace, film=Film(*arrays, map_height))

    def _reset(self) -> None:
        """Put every robot at its start, with vision trusted."""
        self.env.perturb_cameras(self.injector.perturbation(0))
        self._result = self.env.reset()
        self.pilot.reset()
        self._frames = Frames.healthy(self._result.depth)
        self._over = np.zeros(len(self.modes), bool)
        """True where the first try is over, [N] bool."""
        self._retired = np.zeros(len(self.modes), bool)
        """True for robots that are no longer simulated, [N] bool."""

    def _retire(self) -> None:
        """Stop the work for robots whose first try is over, where environment and policy can."""
        self._retired = self._over.copy()
        for worker in (self.env, self.policy):
            if hasattr(worker, "retire"):
                worker.retire(self._retired)

    def _act(self, step: int, trace: Trace) -> np.ndarray:
        """Take new frames, act for a control step, then judge the images and record the answers.

        Returns:
            Actions, [N, 12].
        """
        result = self._result
        pilot = self.pilot
        if step % STEPS_PER_TICK == 0:
            live = Frames.healthy(result.depth, result.angular_velocity)
            self._frames = self.injector.apply(live, step, self._retired)
        failing = self.injector.at_work(step)
        # Mode oracle is told which cameras fail.
        oracle_mask = failing & (self.modes == ORACLE)
        action = pilot.act(result.proprioception, self._images(step), oracle_mask)
        # A judgement takes effect in the next control step.
        for update in range(UPDATES_PER_STEP):
            images = self._images(step, update)
            seen = pilot.seen(images, images.fresh)
            self.on_update(seen)
            pilot.judge(seen, now=(step * UPDATES_PER_STEP + update + 1) * PHYSICS_DT)
            trace.trusted[step, update] = pilot.trusted
        trace.vision[step] = pilot.vision
        trace.unseen[step] = pilot.unseen
        trace.failing[step] = failing
        trace.anomaly[step] = self.policy.anomaly_score
        trace.probability[step] = pilot.probability
        trace.has_image[step] = getattr(self.policy, "has_image", True)
        trace.map_error[step] = getattr(self.policy, "map_error", 0.0)
        return action

    def _images(self, step: int, update: int = 0) -> Images:
        """Return the newest tick's frames with ages; they are fresh in its first update only."""
        frames = self._frames
        passed = step % STEPS_PER_TICK * CONTROL_DT + update * PHYSICS_DT
        fresh = frames.fresh if passed == 0.0 else np.zeros_like(frames.fresh)
        return Images(frames.image, fresh, frames.age + passed, frames.invalid)

    def _advance(self, action: np.ndarray, step: int, trace: Trace) -> None:
        """Step the environment, record the true state, and reset the pilot where episodes ended."""
        # The images of the next step are rendered at the end of this one.
        self.env.perturb_cameras(self.injector.perturbation(step + 1))
        self._result = self.env.step(action)
        for state in fields(TrueState):
            getattr(trace, state.name)[step] = getattr(self._result, state.name)
        ended = self._result.ended
        self._over |= ended
        if ended.any():
            self.pilot.reset(ended)


def robot_numbers(trials: Sequence[Trial]) -> list[int]:
    """Return the number of each trial's robot; robots with the same number are twins."""
    return [trial.robot for trial in trials]


def pilot_modes(trials: Sequence[Trial]) -> list[str]:
    """Return the pilot's mode of each trial; mode oracle is camera with the rollout's distrust."""
    return ["camera" if trial.mode == ORACLE else trial.mode for trial in trials]
