"""Lets robots walk the courses of episodes: commands and camera faults by place, not by time.

Whoever is slower meets the same turn, the same stop and the same fault at the same place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from renet.evaluation.benchmark.episodes import Episode
from renet.evaluation.benchmark.families import SealedFaults, fault_of
from renet.evaluation.benchmark.modes import HEALTHY
from renet.evaluation.benchmark.stranger import stranger
from renet.evaluation.conditions import as_trained
from renet.evaluation.env import SimEnv
from renet.evaluation.rollout import Trial
from renet.evaluation.trace import StepResult
from renet.faults import Frames, PhysicalFault, ViewPerturbation
from renet.interface import CONTROL_DT
from renet.robots import Robot
from renet.tasks import RenetEnvCfg
from renet.tasks.mdp.commands import goal
from renet.tasks.parkour_env_cfg import parkour_env_cfg, randomize, tile_env_cfg
from renet.tasks.terrains import course_row
from renet.terrain.course import WIDTH, Course

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

BEYOND = 0.5
"""An obstacle is crossed once the base is so far beyond its last edge, m."""
SUNK = 0.25
"""A base so far below the line on which feet walk has fallen, m."""
AIM = 0.1
"""Robots start within this angle of straight, rad."""
MARGIN = 0.5
"""A robot so near a side of the course has left it, m."""
CAMERA_NOISE = 0.03
"""Standard deviation of every depth, m, whatever a policy was trained with."""


def course_env_cfg(courses: dict[str, Course], robot: Robot) -> RenetEnvCfg:
    """Courses side by side, with the robots, sensors and pushes of training.

    They are the recipe's when version 3 was frozen, and motors as measured on real robots.
    """
    cfg = tile_env_cfg(course_row(courses), play=True, robot=robot)
    trained = parkour_env_cfg(robot=robot)
    randomize(
        trained,
        motor_strength=0.2,
        # A real Go1's motors brake 1.7 times as strongly as they are told.
        damping=(0.7, 1.6),
        joint_friction=0.1,
        joint_offset=0.03,
        camera_delay=0.1,
        camera_position=0.03,
        camera_angle=0.14,
    )
    as_trained(cfg, trained)
    # A motor has no torque left at its largest speed, or somewhat above.
    randomize(cfg, no_load_speed=(1.0, 1.5))
    # They judge tiles by the height of their start.
    for name in ("in_gap", "below_map", "left_tile"):
        del cfg.terminations[name]
    spawn = cfg.events["spawn"].params["pose_range"]
    spawn |= {"x": (-0.2, 0.2), "y": (-0.2, 0.2), "yaw": (-AIM, AIM)}
    return cfg


@dataclass
class Walk:
    """What happened to N robots, each in its episode; [N] unless said otherwise."""

    crossed: np.ndarray
    """Obstacles that are behind the robot."""
    fell: np.ndarray
    """bool"""
    arrived: np.ndarray
    """bool: at the end of the course."""
    seconds: np.ndarray
    """s until the episode was over."""
    metres: np.ndarray
    """Farthest position, m."""
    joules: np.ndarray
    """Sum of |torque * joint velocity|."""
    peak_torque: np.ndarray
    """Largest torque of any motor, N m."""
    speed_error: np.ndarray
    """Mean of |speed along the commanded heading less the commanded one|, m/s."""

    @classmethod
    def begun(cls, count: int) -> Walk:
        """Of robots that have not moved yet."""
        flags = ("fell", "arrived")
        counts = {"crossed": int} | dict.fromkeys(flags, bool)
        return cls(**{f.name: np.zeros(count, counts.get(f.name, float)) for f in fields(cls)})

    @classmethod
    def joined(cls, walks: Sequence[Walk], order: np.ndarray) -> Walk:
        """Several walks one after the other, then in another order, [N] places."""
        names = [f.name for f in fields(cls)]
        return cls(
            **{name: np.concatenate([getattr(w, name) for w in walks])[order] for name in names}
        )

    def rows(self, places: np.ndarray) -> Walk:
        """Of some robots, by their places."""
        return Walk(**{name: values[places] for name, values in vars(self).items()})


class CourseEnv:
    """Robots on courses as the environment of a rollout: steers them, and ends their episodes."""

    def __init__(self, env: SimEnv, episodes: Sequence[Episode]) -> None:
        """Take over an environment with a row for each of the episodes, [N]."""
        self._inner = env
        self.num_robots = env.num_robots
        self.perturb_cameras = env.perturb_cameras
        self.retire = env.retire
        self.poses = env.poses
        self._episodes = episodes
        courses = [episode.course for episode in episodes]
        self._courses = courses
        self._last_edges = [course.edges[:, 1] + BEYOND for course in courses]
        self._headings = np.array([episode.headings for episode in episodes])
        self._speed = np.array([episode.speed for episode in episodes])
        self._turn_at = np.array([episode.turn_at for episode in episodes])
        self._stop_at = np.array([episode.stop_at for episode in episodes])
        self._limit = np.array([episode.seconds for episode in episodes])
        env.place_on([episode.name for episode in episodes])
        self.position = np.zeros(self.num_robots)
        """Position along the course, [N] m."""
        self.farthest = np.zeros(self.num_robots)
        """Largest position so far, [N] m."""

    def reset(self) -> StepResult:
        """Put every robot at the start of its course."""
        count = self.num_robots
        result = self._inner.reset()
        self._over = np.zeros(count, bool)
        self._standing = np.array([episode.stop_seconds for episode in self._episodes])
        """Seconds for which robots are still to stand, [N]."""
        self._error_sum = np.zeros(count)
        self.walk = Walk.begun(count)
        self.position = self._place()[0]
        self.farthest = self.position.copy()
        self._steer()
        return result

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step; episodes end as the benchmark has them."""
        asked = self._asked
        result = self._inner.step(action)
        place, aside, height = self._place()
        # Robots whose episode has ended are at their next start already.
        going = ~result.ended
        self.position = np.where(going, place, self.position)
        self.farthest = np.maximum(self.farthest, self.position)
        ground = np.array([c.walking_height(x) for c, x in zip(self._courses, place, strict=True)])
        fell = result.fell | (going & (height < ground - SUNK))
        walk, live = self.walk, ~self._over
        passed = [
            int((edges <= x).sum())
            for edges, x in zip(self._last_edges, self.farthest, strict=True)
        ]
        walk.crossed = np.where(live & ~fell, passed, walk.crossed)
        walk.arrived |= live & ~fell & (walk.crossed == [len(e) for e in self._last_edges])
        walk.fell |= live & fell
        walk.seconds += CONTROL_DT * live
        walk.metres = np.where(live, self.farthest, walk.metres)
        walk.joules += CONTROL_DT * live * result.power
        walk.peak_torque = np.where(
            live, np.maximum(walk.peak_torque, self._torque()), walk.peak_torque
        )
        self._error_sum += CONTROL_DT * live * np.abs(result.forward_velocity - asked)
        walk.speed_error = self._error_sum / np.maximum(walk.seconds, CONTROL_DT)
        late = walk.seconds >= self._limit - CONTROL_DT / 2
        left = np.abs(aside) > WIDTH / 2 - MARGIN
        self._over |= result.ended | fell | walk.arrived | late | left
        self._steer()
        return replace(result, fell=fell, ended=self._over.copy())

    def _place(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position along the course, to its left, and height above its start, [N] m each."""
        env = self._inner.env
        place = env.scene["robot"].data.root_link_pos_w - env.scene.env_origins
        along, aside, height = place.numpy().astype(float).T
        return along, aside, height

    def _torque(self) -> np.ndarray:
        """Largest torque of a motor now, [N] N m."""
        data = self._inner.env.scene["robot"].data
        return data.qfrc_actuator.abs().amax(-1).numpy()

    def _steer(self) -> None:
        """Tell every robot its speed and heading, from the next step on."""
        stands = (self.farthest >= self._stop_at) & (self._standing > 0.0)
        self._standing = self._standing - CONTROL_DT * stands
        turned = (self.farthest >= self._turn_at).astype(int)
        heading = np.take_along_axis(self._headings, turned[:, None], axis=1)[:, 0]
        self._asked = np.where(stands, 0.0, self._speed)
        self._command(self._asked, heading)

    def _command(self, speed: np.ndarray, heading: np.ndarray) -> None:
        """Set the goals: speeds [N] m/s, and headings [N] rad from straight along the course."""
        command = goal(self._inner.env)
        command.speed[:] = torch.from_numpy(speed)
        command.yaw[:] = torch.from_numpy(heading)


class PlacedFaults:
    """Spoils the frames of N robots from a place of each one's course on, for some seconds.

    Stands in for `renet.faults.Injector`, whose faults begin at a time.
    """

    def __init__(
        self,
        env: CourseEnv,
        episodes: Sequence[Episode | None],
        seed: int,
        sealed: SealedFaults | None = None,
    ) -> None:
        """Set up the faults.

        Args:
            env: of N robots. episodes: whose fault each camera has; None: it stays healthy.
            seed: of what is random in faults, with the episode's number: the same for twins.
            sealed: the sealed families, if episodes have faults of theirs.
        """
        self._env = env
        self._faults = []
        for row, episode in enumerate(episodes):
            if episode is not None:
                random = np.random.default_rng([seed, episode.number])
                fault = fault_of(episode.fault, sealed)(episode.level, [random])
                self._faults.append((row, episode, fault))
        self._began = np.full(len(episodes), -1)
        """Control step at which each robot's camera began to fail; -1: not yet."""
        self._ends = np.zeros(len(episodes))
        self._onset = np.full(len(episodes), np.inf)
        for row, episode, fault in self._faults:
            self._onset[row] = episode.onset
            self._ends[row] = min(episode.duration, fault.lasts(episode.level))

    def _elapsed(self, step: int) -> np.ndarray:
        """Seconds since each camera began to fail, [N]; -1 where it does not."""
        begins = (self._began < 0) & (self._env.farthest >= self._onset)
        self._began[begins] = step
        time = (step - self._began) * CONTROL_DT
        return np.where((self._began >= 0) & (time < self._ends), time, -1.0)

    def at_work(self, step: int) -> np.ndarray:
        """[N] bool: robots whose camera fails at a control step."""
        return self._elapsed(step) >= 0.0

    def perturbation(self, step: int) -> ViewPerturbation:
        """The cameras' view of their scene at a control step."""
        view = ViewPerturbation.none(len(self._began))
        elapsed = self._elapsed(step)
        for row, _, fault in self._faults:
            if isinstance(fault, PhysicalFault) and elapsed[row] >= 0.0:
                fault.apply(view, np.array([row]), float(elapsed[row]))
        return view

    def apply(self, frames: Frames, step: int, spared: np.ndarray | None = None) -> Frames:
        """The frames after the faults; called once in each vision tick.

        Args:
            frames: of all robots. step: control step.
            spared: [N] bool, robots whose frames nobody looks at any more.
        """
        frames = frames.copy()
        elapsed = self._elapsed(step)
        for row, _, fault in self._faults:
            if spared is not None and spared[row]:
                continue
            own = np.array([row])
            spoilt = fault.corrupt(frames.rows(own), elapsed[own])
            if elapsed[row] >= 0.0:
                frames.write(own, spoilt)
        return frames


TOLD_FIRST = 0.5
"""Speed of the first control step, before the episode's is told, m/s."""


def walk_episodes(
    evaluator: Evaluator,
    episodes: Sequence[Episode],
    modes: dict[str, str],
    seed: int,
    title: str,
    sealed: SealedFaults | None = None,
) -> dict[str, Walk]:
    """Let a policy walk a block of episodes, strangers after the others.

    Args:
        evaluator: of the policy. episodes: of the block.
        modes: the rollout's mode of each entry, by the entry's name; `HEALTHY` meets no fault.
        seed: of bodies, starts, noise and pushes. title: of the progress bar.
        sealed: the sealed families, if episodes have faults of theirs.

    Returns:
        What happened, by the entries' names, each with a row for every episode.
    """
    robots = {False: evaluator.robot, True: stranger(evaluator.robot)}
    parts: dict[str, list[Walk]] = {entry: [] for entry in modes}
    order: list[int] = []
    for strange, robot in robots.items():
        places = [i for i, episode in enumerate(episodes) if episode.stranger == strange]
        if not places:
            continue
        some = [episodes[place] for place in places]
        bar = f"{title}, stranger" if strange else title
        walks = _walk_on(evaluator, robot, some, modes, seed, bar, sealed)
        for entry, walk in walks.items():
            parts[entry].append(walk)
        order += places
    back = np.argsort(order)
    return {entry: Walk.joined(walks, back) for entry, walks in parts.items()}


def _walk_on(
    evaluator: Evaluator,
    robot: Robot,
    episodes: Sequence[Episode],
    modes: dict[str, str],
    seed: int,
    title: str,
    sealed: SealedFaults | None,
) -> dict[str, Walk]:
    """Walk episodes on one robot; see `walk_episodes`."""
    courses = {episode.name: episode.course for episode in episodes}
    cfg = course_env_cfg(courses, robot)
    # Twins: every entry has the same bodies and noise.
    numbers = list(range(len(episodes))) * len(modes)
    sim = evaluator.make_env(cfg, numbers, TOLD_FIRST, seed, camera_noise=CAMERA_NOISE)
    env = CourseEnv(sim, list(episodes) * len(modes))
    trials = [Trial(mode, (), number) for mode in modes.values() for number in range(len(episodes))]
    rollout = evaluator.rollout(env, trials, seed)
    failing = [None if entry == HEALTHY else episode for entry in modes for episode in episodes]
    rollout.injector = PlacedFaults(env, failing, seed, sealed)
    steps = round(max(episode.seconds for episode in episodes) / CONTROL_DT) + 1
    rollout.run(steps, title, until_ended=1, retire=True)
    count = len(episodes)
    return {
        entry: env.walk.rows(np.arange(count) + count * place) for place, entry in enumerate(modes)
    }
