"""Simulation of episodes: robots on courses, with commands and camera faults by place, not by time.

A slower robot meets the same turn, the same stop and the same fault at the same place.
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
from renet.evaluation.conditions import use_training_conditions
from renet.evaluation.env import SimEnv
from renet.evaluation.rollout import Trial
from renet.evaluation.trace import StepResult
from renet.faults import Frames, PhysicalFault, ViewPerturbation
from renet.faults.base import Fault
from renet.interface import CONTROL_DT, control_steps
from renet.robots import Robot
from renet.tasks import RenetEnvCfg
from renet.tasks.mdp.commands import goal
from renet.tasks.parkour_env_cfg import parkour_env_cfg, randomize, tile_env_cfg
from renet.tasks.terrains import course_row
from renet.terrain.course import COURSE_WIDTH, Course

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

_CLEARANCE = 0.5
"""Distance of the base beyond an obstacle's last edge at which it counts as crossed, m."""
SUNK = 0.25
"""Depth of the base below the line on which feet walk from which on it has fallen, m."""
_START_YAW = 0.1
"""Largest yaw of a robot's start, either way, rad."""
_SIDE_MARGIN = 0.5
"""Distance to a side of the course at which a robot has left it, m."""
CAMERA_NOISE = 0.03
"""Standard deviation of every depth, m, whatever a policy was trained with."""
_FIRST_SPEED = 0.5
"""Commanded speed of the first control step, before the episode's is set, m/s."""


def course_env_cfg(courses: dict[str, Course], robot: Robot) -> RenetEnvCfg:
    """Make a task of courses side by side, by name, with training's robots, sensors and pushes.

    The ranges come from the training recipe at the time when version 3 was frozen, and from motors
    measured on real robots.
    """
    cfg = tile_env_cfg(course_row(courses), play=True, robot=robot)
    trained = parkour_env_cfg(robot=robot)
    randomize(
        trained,
        motor_strength=0.2,
        # A real Go1's motors brake 1.7 times as strongly as commanded.
        damping=(0.7, 1.6),
        joint_friction=0.1,
        joint_offset=0.03,
        camera_delay=0.1,
        camera_position=0.03,
        camera_angle=0.14,
    )
    use_training_conditions(cfg, trained)
    # A motor's torque reaches zero at its largest speed, or somewhat above.
    randomize(cfg, no_load_speed=(1.0, 1.5))
    # These terminations compare heights with the tile's start, but courses go up and down.
    for name in ("in_gap", "below_map", "left_tile"):
        del cfg.terminations[name]
    spawn = cfg.events["spawn"].params["pose_range"]
    spawn |= {"x": (-0.2, 0.2), "y": (-0.2, 0.2), "yaw": (-_START_YAW, _START_YAW)}
    return cfg


@dataclass
class Walk:
    """Measures of N robots, each in its episode; [N] each."""

    crossed: np.ndarray
    """Number of obstacles behind the robot."""
    fell: np.ndarray
    """True if the robot fell, bool."""
    arrived: np.ndarray
    """True if the robot reached the end of the course, bool."""
    seconds: np.ndarray
    """Time until the episode was over, s."""
    metres: np.ndarray
    """Farthest position along the course, m."""
    joules: np.ndarray
    """Energy, J: integral of |torque * joint velocity| over all joints."""
    peak_torque: np.ndarray
    """Largest torque of any motor, N m."""
    speed_error: np.ndarray
    """Mean absolute error of the speed along the commanded heading, m/s."""

    @classmethod
    def at_start(cls, count: int) -> Walk:
        """Return the measures of robots that have not moved yet."""
        types = {"crossed": int, "fell": bool, "arrived": bool}
        zeros = {}
        for field in fields(cls):
            zeros[field.name] = np.zeros(count, types.get(field.name, float))
        return cls(**zeros)

    @classmethod
    def concatenate(cls, walks: Sequence[Walk], order: np.ndarray) -> Walk:
        """Concatenate walks, then take their robots in an order, [N] places."""
        columns = {}
        for field in fields(cls):
            values = np.concatenate([getattr(walk, field.name) for walk in walks])
            columns[field.name] = values[order]
        return cls(**columns)

    def rows(self, places: np.ndarray) -> Walk:
        """Select the measures of some robots, by their places."""
        return Walk(**{name: values[places] for name, values in vars(self).items()})


class CourseEnv:
    """Environment of robots on courses, which sets their commands and ends their episodes."""

    def __init__(self, env: SimEnv, episodes: Sequence[Episode]) -> None:
        """Wrap an environment with a row for each of the episodes, [N]."""
        self._inner = env
        self.num_robots = env.num_robots
        self.perturb_cameras = env.perturb_cameras
        self.retire = env.retire
        self.poses = env.poses
        self._episodes = episodes
        self._courses = [episode.course for episode in episodes]
        self._last_edges = [course.edges[:, 1] + _CLEARANCE for course in self._courses]
        """Positions at which each course's obstacles are crossed, m."""
        self._headings = _values(episodes, "headings")
        self._speed = _values(episodes, "speed")
        self._turn_at = _values(episodes, "turn_at")
        self._stop_at = _values(episodes, "stop_at")
        self._limit = _values(episodes, "seconds")
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
        self._standing = _values(self._episodes, "stop_seconds")
        """Time for which robots still have to stand, [N] s."""
        self._error_sum = np.zeros(count)
        """Integral of the absolute error of speed, [N] m."""
        self.walk = Walk.at_start(count)
        self.position = self._place()[0]
        self.farthest = self.position.copy()
        self._steer()
        return result

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step; episodes end by the benchmark's rules."""
        commanded = self._commanded_speed
        result = self._inner.step(action)
        place, aside, height = self._place()
        # Robots whose episode has ended are at their next start already.
        going = ~result.ended
        self.position = np.where(going, place, self.position)
        self.farthest = np.maximum(self.farthest, self.position)
        fell = result.fell | (going & (height < self._walking_height(place) - SUNK))
        self._measure(result, fell, np.abs(result.forward_velocity - commanded))
        # An episode is over after a fall, at the course's end, after its time, or off the course.
        late = self.walk.seconds >= self._limit - CONTROL_DT / 2
        left = np.abs(aside) > COURSE_WIDTH / 2 - _SIDE_MARGIN
        self._over |= result.ended | fell | self.walk.arrived | late | left
        self._steer()
        return replace(result, fell=fell, ended=self._over.copy())

    def _measure(self, result: StepResult, fell: np.ndarray, speed_error: np.ndarray) -> None:
        """Add a control step to the walk of robots whose episode is not over.

        Args:
            result: Readings after the step.
            fell: Robots that fell in it, [N] bool.
            speed_error: Absolute error of their speed, [N] m/s.
        """
        walk = self.walk
        live = ~self._over
        passed = []
        for edges, position in zip(self._last_edges, self.farthest, strict=True):
            passed.append(int((edges <= position).sum()))
        # What a robot passes while it falls does not count.
        walk.crossed = np.where(live & ~fell, passed, walk.crossed)
        walk.arrived |= live & ~fell & (walk.crossed == list(map(len, self._last_edges)))
        walk.fell |= live & fell
        walk.seconds += CONTROL_DT * live
        walk.metres = np.where(live, self.farthest, walk.metres)
        walk.joules += CONTROL_DT * live * result.power
        peak_torque = np.maximum(walk.peak_torque, self._torque())
        walk.peak_torque = np.where(live, peak_torque, walk.peak_torque)
        self._error_sum += CONTROL_DT * live * speed_error
        walk.speed_error = self._error_sum / np.maximum(walk.seconds, CONTROL_DT)

    def _walking_height(self, position: np.ndarray) -> np.ndarray:
        """Return the height of the line on which feet walk at each robot's position, [N] m."""
        heights = []
        for course, x in zip(self._courses, position, strict=True):
            heights.append(course.walking_height(x))
        return np.array(heights)

    def _place(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return place along the course, offset to the left and height above the start, [N] m."""
        env = self._inner.env
        place = env.scene["robot"].data.root_link_pos_w - env.scene.env_origins
        along, aside, height = place.numpy().astype(float).T
        return along, aside, height

    def _torque(self) -> np.ndarray:
        """Return the largest torque of any motor in the last physics step, [N] N m."""
        data = self._inner.env.scene["robot"].data
        return data.qfrc_actuator.abs().amax(-1).numpy()

    def _steer(self) -> None:
        """Set every robot's speed and heading for the next step."""
        # The stop and the turn begin at a place of the course.
        stands = (self.farthest >= self._stop_at) & (self._standing > 0.0)
        self._standing = self._standing - CONTROL_DT * stands
        turned = (self.farthest >= self._turn_at).astype(int)
        heading = np.take_along_axis(self._headings, turned[:, None], axis=1)[:, 0]
        self._commanded_speed = np.where(stands, 0.0, self._speed)
        self._command(self._commanded_speed, heading)

    def _command(self, speed: np.ndarray, heading: np.ndarray) -> None:
        """Set speeds [N] m/s and headings [N] rad, counted from straight along the course."""
        command = goal(self._inner.env)
        command.speed[:] = torch.from_numpy(speed)
        command.yaw[:] = torch.from_numpy(heading)


def _values(episodes: Sequence[Episode], name: str) -> np.ndarray:
    """Return a property of each episode, [N] or [N, 2]."""
    return np.array([getattr(episode, name) for episode in episodes])


class PlacedFaults:
    """Camera faults of N robots that begin at a place of each course and last for some seconds.

    It has the interface of `renet.faults.Injector`, whose faults begin at a time.
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
            env: Environment of N robots.
            episodes: The episode whose fault each camera has, [N]; None for a healthy camera.
            seed: Seed of the faults' randomness, together with the episode's number, so that twins
                have the same.
            sealed: The sealed families, if episodes have faults of theirs.
        """
        self._env = env
        self._faults: list[tuple[int, Fault]] = []
        """Row and fault of each camera that fails."""
        self._began = np.full(len(episodes), -1)
        """Control step at which each robot's camera began to fail, [N]; -1 before."""
        self._duration = np.zeros(len(episodes))
        """Time for which each camera fails, [N] s."""
        self._onset = np.full(len(episodes), np.inf)
        """Position at which each camera begins to fail, [N] m."""
        for row, episode in enumerate(episodes):
            if episode is None:
                continue
            random = np.random.default_rng([seed, episode.number])
            fault = fault_of(episode.fault, sealed)(episode.level, [random])
            self._faults.append((row, fault))
            self._onset[row] = episode.onset
            self._duration[row] = min(episode.duration, fault.lasts(episode.level))

    def _elapsed(self, step: int) -> np.ndarray:
        """Return the time since each camera began to fail, [N] s; -1 where it does not fail."""
        begins = (self._began < 0) & (self._env.farthest >= self._onset)
        self._began[begins] = step
        time = (step - self._began) * CONTROL_DT
        return np.where((self._began >= 0) & (time < self._duration), time, -1.0)

    def at_work(self, step: int) -> np.ndarray:
        """Return a mask of the robots whose camera fails at a control step, [N] bool."""
        return self._elapsed(step) >= 0.0

    def perturbation(self, step: int) -> ViewPerturbation:
        """Return the perturbation of the cameras' view of the scene at a control step."""
        view = ViewPerturbation.none(len(self._began))
        elapsed = self._elapsed(step)
        for row, fault in self._faults:
            if isinstance(fault, PhysicalFault) and elapsed[row] >= 0.0:
                fault.apply(view, np.array([row]), float(elapsed[row]))
        return view

    def apply(self, frames: Frames, step: int, spared: np.ndarray | None = None) -> Frames:
        """Apply the faults to frames; called once in each vision tick.

        Args:
            frames: Frames of all robots.
            step: Control step.
            spared: Mask of the robots whose frames are no longer used, [N] bool.

        Returns:
            A copy of the frames with the faults.
        """
        frames = frames.copy()
        elapsed = self._elapsed(step)
        for row, fault in self._faults:
            if spared is not None and spared[row]:
                continue
            own = np.array([row])
            # A fault sees the frames before its onset, too: some repeat an earlier one.
            corrupted = fault.corrupt(frames.rows(own), elapsed[own])
            if elapsed[row] >= 0.0:
                frames.write(own, corrupted)
        return frames


def walk_episodes(
    evaluator: Evaluator,
    episodes: Sequence[Episode],
    modes: dict[str, str],
    seed: int,
    title: str,
    sealed: SealedFaults | None = None,
) -> dict[str, Walk]:
    """Walk a block of episodes, those of strangers after the others.

    Args:
        evaluator: Evaluator of the policy.
        episodes: Episodes of the block, [N].
        modes: The rollout's mode of each entry, by the entry's name; `HEALTHY` meets no fault.
        seed: Seed of bodies, starts, noise and pushes.
        title: Title of the progress.
        sealed: The sealed families, if episodes have faults of theirs.

    Returns:
        Measures by the entries' names, each with a row for every episode.
    """
    # One simulation holds one kind of robot.
    robots = {False: evaluator.robot, True: stranger(evaluator.robot)}
    parts: dict[str, list[Walk]] = {}
    order: list[int] = []
    for is_stranger, robot in robots.items():
        places = np.flatnonzero(_values(episodes, "stranger") == is_stranger).tolist()
        if not places:
            continue
        group = [episodes[place] for place in places]
        bar = f"{title}, stranger" if is_stranger else title
        walks = _walk_on(evaluator, robot, group, modes, seed, bar, sealed)
        for entry, walk in walks.items():
            parts.setdefault(entry, []).append(walk)
        order += places
    # Back to the episodes' order.
    back = np.argsort(order)
    return {entry: Walk.concatenate(walks, back) for entry, walks in parts.items()}


def _walk_on(
    evaluator: Evaluator,
    robot: Robot,
    episodes: Sequence[Episode],
    modes: dict[str, str],
    seed: int,
    title: str,
    sealed: SealedFaults | None,
) -> dict[str, Walk]:
    """Walk episodes with one kind of robot; see `walk_episodes`."""
    count = len(episodes)
    courses = {episode.name: episode.course for episode in episodes}
    cfg = course_env_cfg(courses, robot)
    # The robots of different entries are twins, with the same bodies and noise.
    numbers = list(range(count)) * len(modes)
    sim = evaluator.make_env(cfg, numbers, _FIRST_SPEED, seed, camera_noise=CAMERA_NOISE)
    env = CourseEnv(sim, list(episodes) * len(modes))
    trials = []
    failing: list[Episode | None] = []
    for entry, mode in modes.items():
        trials += [Trial(mode, (), number) for number in range(count)]
        failing += [None] * count if entry == HEALTHY else episodes
    rollout = evaluator.rollout(env, trials, seed)
    rollout.injector = PlacedFaults(env, failing, seed, sealed)
    steps = control_steps(max(episode.seconds for episode in episodes)) + 1
    rollout.run(steps, title, until_ended=1, retire=True)
    walks = {}
    for place, entry in enumerate(modes):
        walks[entry] = env.walk.rows(np.arange(count) + count * place)
    return walks
