"""The paper's long walk: a kilometre in each mode, and where robots fall on it.

`python benchmarks/paper/kilometre.py` leaves results/kilometre. Ten robots walk a lap side by side,
with the differences, sensors and pushes of the fault benchmark; laps are walked until each mode has
gone a kilometre. Sections are those of the paper's figure: sparse and dense grass, stairs, a steep
slope, gaps in a row, a platform of 48 cm, and a lens that somebody covers. A robot that falls or
gets stuck is counted, and set down at the beginning of the next section.

`--modes memory blind --robots 5 --laps 1 --film FILE.webp` films two of them, too.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import scipy
import torch
import tyro
from mujoco import MjSpec

import kilometre_film
from kilometre_film import Visit
from renet.errors import RenetError
from renet.evaluation.benchmark.modes import ROLLOUT_MODES
from renet.evaluation.benchmark.walking import CAMERA_NOISE, SUNK, course_env_cfg
from renet.evaluation.env import SimEnv
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import group_by
from renet.evaluation.rollout import Trial
from renet.evaluation.settings import Conditions, check_modes
from renet.evaluation.study import Part, Study, Table
from renet.evaluation.trace import StepResult, Trace
from renet.faults import FAULTS, Frames, ViewPerturbation
from renet.files import remove
from renet.interface import CONTROL_DT, control_steps
from renet.tasks.mdp.commands import goal
from renet.terrain.course import Course, Gap, Obstacle, Plain, Platform, Ramp, Stairs

RUN_UP = 1.5
"""Level ground at the beginning of each section, m."""
SET_DOWN = 0.45
"""Distance from a section's beginning at which robots are set down, m: their hind feet stand on its
level ground, not in the last section's gap or platform, and its camera does not fail yet."""
LOOK_AHEAD = 3.0
"""Robots are steered at the middle line this far ahead, m."""
SPEED = 0.6
"""Commanded, m/s."""
STUCK_AFTER = 15.0
"""Seconds in a section after which a robot counts as stuck."""
LAP = "lap"
"""Name of the lap's tile."""


@dataclass(frozen=True)
class Section:
    """A part of a lap, and what its camera meets there."""

    name: str
    obstacles: tuple[Obstacle, ...]
    fault: str | None = None
    """Fault of the camera within the section, from half a metre behind its beginning on."""
    severity: int = 5


SECTIONS = (
    Section("sparse grass", (Plain(3.0),), "grass", 2),
    Section("dense grass", (Plain(3.0),), "tall_grass", 5),
    Section("stairs up", (Stairs(0.15, 0.30, 6),)),
    Section("covered lens, flat", (Plain(2.0),), "occlusion"),
    Section("stairs down", (Stairs(-0.15, 0.30, 6),)),
    Section("steep slope", (Ramp(22.0, 2.0, 1.2),)),
    Section("covered lens, stairs", (Stairs(0.15, 0.30, 3), Stairs(-0.15, 0.30, 3)), "occlusion"),
    Section("gaps in a row", (Gap(0.4), Gap(0.4), Gap(0.4))),
    Section("platform of 48 cm", (Platform(0.48, 1.5),)),
    Section("covered lens, gap", (Gap(0.45),), "occlusion"),
)
"""Before each section with a covered lens robots can see again."""
BETWEEN = 0.8
"""Ground between two obstacles of a section, m."""


@dataclass(frozen=True)
class Lap:
    """Sections in a row as one course."""

    sections: tuple[Section, ...] = SECTIONS

    @property
    def course(self) -> Course:
        """The tile to walk."""
        obstacles = [obstacle for section in self.sections for obstacle in section.obstacles]
        spaces = [
            RUN_UP if first else BETWEEN
            for section in self.sections
            for first in (True, *[False] * (len(section.obstacles) - 1))
        ]
        return Course(obstacles=tuple(obstacles), spaces=tuple(spaces))

    @property
    def starts(self) -> np.ndarray:
        """Where each section begins, and where the last one ends, [sections + 1] m."""
        lengths = [
            RUN_UP
            + sum(obstacle.extent for obstacle in section.obstacles)
            + BETWEEN * (len(section.obstacles) - 1)
            for section in self.sections
        ]
        return np.concatenate(([0.0], np.cumsum(lengths)))


class LapEnv:
    """Robots on a lap as the environment of a rollout; those that fail are set down further on."""

    def __init__(self, env: SimEnv, lap: Lap) -> None:
        """Take over an environment of robots on the lap's tile."""
        self._inner = env
        self.num_robots = env.num_robots
        self.perturb_cameras = env.perturb_cameras
        self.poses = env.poses
        env.place_on([LAP] * env.num_robots)
        self._course = lap.course
        self._starts = lap.starts
        self._landings = lap.starts[:-1] + SET_DOWN
        """Where robots are set down in each section, m."""
        self._last = len(lap.sections) - 1
        self._origins = env.env.scene.env_origins.clone()
        self.position = np.zeros(env.num_robots)
        """Along the lap, [N] m."""
        self.section = np.zeros(env.num_robots, int)
        """The section each robot is in, [N]."""
        self.finished = np.zeros(env.num_robots, bool)
        """[N]: at the end of the lap; what happens afterwards does not count."""
        self.ends = np.full((env.num_robots, len(lap.sections)), "crossed", object)
        """How each section ended, [N, sections]: crossed, fell or stuck."""
        self.metres = np.zeros(env.num_robots)
        """Walked, [N] m."""
        self._seconds = np.zeros(env.num_robots)
        """Seconds in the section, [N]."""

    def reset(self) -> StepResult:
        """Put every robot at the start of the lap."""
        result = self._inner.reset()
        self._origins = self._inner.env.scene.env_origins.clone()
        self.position, _, _ = self._place()
        self._steer()
        return result

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step, and set those down that have failed."""
        before = self.position
        following = np.minimum(self.section + 1, self._last)
        self._set_origins(self._landings[following])
        result = self._inner.step(action)
        position, _, height = self._place()
        self._seconds += CONTROL_DT
        ground = self._course.walking_height(position)
        sunk = ~result.ended & (height < ground - SUNK)
        stuck = ~result.ended & ~sunk & (self._seconds > STUCK_AFTER)
        # mjlab has set down those that it saw fall; the others are set down here.
        self._set_down(sunk | stuck)
        fell = result.fell | sunk
        failed = fell | stuck
        live = ~self.finished
        rows = np.arange(self.num_robots)
        for end, mask in (("fell", fell & live), ("stuck", stuck & live)):
            self.ends[rows[mask], self.section[mask]] = end
        self.finished |= failed & (self.section == self._last)
        self.position = np.where(failed, self._landings[following], position)
        self.metres += np.where(live & ~failed, np.maximum(self.position - before, 0.0), 0.0)
        reached = np.searchsorted(self._starts, self.position, side="right") - 1
        section = np.maximum(self.section, np.minimum(reached, self._last))
        section = np.where(failed, following, section)
        self._seconds = np.where(section != self.section, 0.0, self._seconds)
        self.section = section
        self.finished |= self.position >= self._starts[-1]
        self._steer()
        return replace(result, fell=fell, ended=result.ended | failed)

    def _place(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position along the lap, to its left, and height above its start, [N] m each."""
        root = self._inner.env.scene["robot"].data.root_link_pos_w
        along, aside, height = (root - self._origins).numpy().astype(float).T
        return along, aside, height

    def _set_origins(self, positions: np.ndarray) -> None:
        """Let robots that are reset begin at these positions, [N] m."""
        origins = self._origins.clone()
        origins[:, 0] += torch.from_numpy(positions).float()
        origins[:, 2] += torch.from_numpy(self._course.walking_height(positions)).float()
        self._inner.env.scene.env_origins[:] = origins

    def _set_down(self, mask: np.ndarray) -> None:
        """Reset the masked robots, [N] bool."""
        rows = torch.from_numpy(np.flatnonzero(mask))
        if len(rows):
            env = self._inner.env
            env._reset_idx(rows)
            env.scene.write_data_to_sim()
            env.sim.forward()

    def _steer(self) -> None:
        """Point every goal at the middle line."""
        _, aside, _ = self._place()
        command = goal(self._inner.env)
        command.speed[:] = SPEED
        command.yaw[:] = torch.from_numpy(-np.arctan2(aside, LOOK_AHEAD)).float()


class SectionFaults:
    """Cameras that fail while their robot is in a section where they do."""

    def __init__(self, env: LapEnv, lap: Lap, streams: Sequence[int], seed: int) -> None:
        """Set up the faults; robots of one stream draw the same noise."""
        self._env = env
        self._began = np.zeros(len(streams))
        self._was = np.full(len(streams), -1)
        self._faults = {}
        for number, section in enumerate(lap.sections):
            if section.fault is not None:
                rngs = [np.random.default_rng([seed, number, stream]) for stream in streams]
                fault = FAULTS[section.fault]
                self._faults[number] = fault(fault.level_of(section.severity), rngs)
        self._places = lap.starts[:-1] + 0.5

    def at_work(self, step: int) -> np.ndarray:
        """[N] bool: robots whose camera fails at a control step."""
        here = np.isin(self._env.section, list(self._faults))
        return here & (self._env.position >= self._places[self._env.section])

    def perturbation(self, step: int) -> ViewPerturbation:
        """The scene is what it looks like."""
        return ViewPerturbation.none(len(self._began))

    def apply(self, frames: Frames, step: int, spared: np.ndarray | None = None) -> Frames:
        """The frames after the faults; called once in each vision tick."""
        failing = self.at_work(step)
        now = np.where(failing, self._env.section, -1)
        self._began = np.where(now != self._was, step, self._began)
        self._was = now
        for number, fault in self._faults.items():
            elapsed = np.where(now == number, (step - self._began) * CONTROL_DT, -1.0)
            frames = fault.corrupt(frames, elapsed)
        return frames


ModeName = Literal["memory", "switch", "camera", "blind"]


@dataclass(frozen=True)
class KilometreStudy(Study):
    """A kilometre in each mode: falls, and time on each estimator."""

    out: Path = Path("results/kilometre")
    """Folder for summary.json, summary.csv and parts/."""
    modes: tuple[ModeName, ...] = ("memory", "switch", "camera", "blind")
    """Modes to compare."""
    robots: int = 10
    """Robots of each mode that walk a lap side by side."""
    laps: int = 3
    """Times each robot walks the lap; `quick`: once."""
    film: Path | None = None
    """Film of the first lap, an animated .webp: on some sections the first of the modes beside the
    last, of the first robot of which most of these sections are crossed in the first mode alone."""

    # Hidden, because the lap has those of the fault benchmark.
    conditions: tyro.conf.Suppress[Conditions] = "nominal"

    name: ClassVar[str] = "kilometre"
    selectable: ClassVar[tuple[str, ...]] = ("laps", "quick", "film")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_modes(self.modes)
        if self.laps < 1 or self.robots < 1:
            raise RenetError("laps and robots must be at least 1")
        if self.film is not None and len(self.modes) < 2:
            raise RenetError("the film shows two modes side by side: give --modes two or more")
        if self.film is not None and self.film.suffix != ".webp":
            raise RenetError(f"the film is a .webp: give --film {self.film.stem}.webp")

    def run(self, evaluator: Evaluator | None = None) -> dict[str, Any]:
        """Run the study; the first lap is walked again if it is to be filmed."""
        if self.film is not None:
            for part in (self.out / "parts").glob("lap_1-*.json"):
                remove(part)
        return super().run(evaluator)

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One part for each lap."""
        laps = 1 if self.quick else self.laps
        return {f"lap_{n}": partial(self._walk, evaluator, n) for n in range(1, laps + 1)}

    def _walk(self, evaluator: Evaluator, number: int) -> Part:
        """Every robot of every mode walks one lap."""
        lap = Lap()
        robots = list(range(self.robots)) * len(self.modes)
        cfg = course_env_cfg({LAP: lap.course}, evaluator.robot)
        # Robots are set down exactly where they are to be.
        cfg.events["spawn"].params["pose_range"]["x"] = (0.0, 0.0)
        seed = self.seed + 100 * number
        sim = evaluator.make_env(cfg, robots, SPEED, seed, camera_noise=CAMERA_NOISE)
        env = LapEnv(sim, lap)
        trials = []
        for mode in self.modes:
            trials += [Trial(ROLLOUT_MODES[mode], (), n) for n in range(self.robots)]
        rollout = evaluator.rollout(env, trials, seed)
        rollout.injector = SectionFaults(env, lap, robots, seed)
        over: list[np.ndarray] = []
        sections: list[np.ndarray] = []
        positions: list[np.ndarray] = []

        def watch(step: int) -> bool:
            over.append(env.finished.copy())
            sections.append(env.section.copy())
            positions.append(env.position.copy())
            return bool(env.finished.all())

        steps = control_steps(len(lap.sections) * STUCK_AFTER)
        filmed = self.film is not None and number == 1
        rows_filmed = range(len(trials)) if filmed else ()
        trace = rollout.run(steps, f"lap {number}", film=rows_filmed, on_step=watch)
        walking = ~np.array(over)
        if filmed:
            visit = Visit(trace, np.array(sections), np.array(positions), ~walking)
            self._write_film(sim.scene_spec, visit, lap, env.ends)
        rows = []
        for row, robot in enumerate(robots):
            mode = self.modes[row // self.robots]
            rows.append(
                {"mode": mode, "lap": number, "robot": robot}
                | {"metres": env.metres[row], "ends": env.ends[row].tolist()}
                | _estimators(trace, walking, row)
            )
        return {"runs": rows}

    def _write_film(self, spec: MjSpec, visit: Visit, lap: Lap, ends: np.ndarray) -> None:
        """Film the first of the modes beside the last; ends: [N, sections], see `LapEnv`."""
        assert self.film is not None
        numbers = {section.name: number for number, section in enumerate(lap.sections)}
        shown = ends[:, [numbers[name] for name in kilometre_film.SHOWN]]
        robot = kilometre_film.pair(shown.reshape(len(self.modes), self.robots, -1))
        last = (len(self.modes) - 1) * self.robots
        robots = {self.modes[0]: robot, self.modes[-1]: last + robot}
        kilometre_film.write(self.film, spec, visit, robots, numbers, lap.starts)

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """A row for each robot and lap; totals by mode, and ends by section."""
        runs = [run for part in parts.values() for run in part["runs"]]
        groups = {mode: group for (mode,), group in group_by(runs, "mode").items()}
        return {
            "runs": runs,
            "totals": {mode: total(group) for mode, group in groups.items()},
            "sections": {
                section.name: {
                    mode: {
                        end: sum(run["ends"][number] == end for run in group)
                        for end in ("crossed", "fell", "stuck")
                    }
                    for mode, group in groups.items()
                }
                for number, section in enumerate(SECTIONS)
            },
        }

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Totals by mode, and falls by section."""
        rows = [
            (
                mode,
                f"{of['metres'] / 1000:.2f}",
                of["falls"],
                f"{of['falls_per_km']:.1f}",
                f"{of['ci95_low']:.1f} to {of['ci95_high']:.1f}",
                of["stuck"],
                *(f"{100 * of[name]:.0f} %" for name in ("sees", "remembers", "blind")),
            )
            for mode, of in summary["totals"].items()
        ]
        header = ("mode", "km", "falls", "falls/km", "95 %", "stuck", "sees", "remembers", "blind")
        sections = [
            (name, *(f"{of[mode]['fell'] + of[mode]['stuck']}" for mode in of))
            for name, of in summary["sections"].items()
        ]
        modes = list(summary["totals"])
        tries = len(summary["runs"]) // len(modes)
        return [
            ("The kilometre", header, rows),
            (f"Not crossed, of {tries} walks", ("section", *modes), sections),
        ]


def _estimators(trace: Trace, walking: np.ndarray, row: int) -> dict[str, float]:
    """Shares of a robot's time with images, on memory, and blind; walking: [T, N] bool."""
    mine = walking[: len(trace.vision), row]
    vision = trace.vision[mine, row]
    image = trace.has_image[mine, row]
    return {
        "sees": float((vision & image).mean()),
        "remembers": float((vision & ~image).mean()),
        "blind": float((~vision).mean()),
    }


def total(runs: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Sums over a mode's walks; the interval of falls per kilometre is the exact Poisson one."""
    metres = sum(run["metres"] for run in runs)
    ends = [end for run in runs for end in run["ends"]]
    falls = ends.count("fell")
    low = scipy.stats.chi2.ppf(0.025, 2 * falls) / 2 if falls else 0.0
    high = scipy.stats.chi2.ppf(0.975, 2 * (falls + 1)) / 2
    return {
        "metres": metres,
        "falls": falls,
        "stuck": ends.count("stuck"),
        "falls_per_km": 1000 * falls / metres,
        "ci95_low": 1000 * low / metres,
        "ci95_high": 1000 * high / metres,
    } | {
        name: float(np.mean([run[name] for run in runs])) for name in ("sees", "remembers", "blind")
    }


if __name__ == "__main__":
    try:
        study = tyro.cli(KilometreStudy)
        study.main()
        print(f"Results: {study.out}")
    except RenetError as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from error
