"""A policy on the episodes of renet-faults, version 3: `renet evaluate benchmark`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, get_args

import tyro

from renet.errors import RenetError
from renet.evaluation.adapters.options import PolicyOptions
from renet.evaluation.benchmark.episodes import EPISODES, EPISODES_PER_BLOCK, SEED, draw_episodes
from renet.evaluation.benchmark.families import SealedFaults
from renet.evaluation.benchmark.leaderboard import counts, family_table, measures, ranking
from renet.evaluation.benchmark.modes import DEFAULT_ENTRIES, ROLLOUT_MODES, EntryName
from renet.evaluation.benchmark.results import BENCHMARK_VERSION, SETS, make_result, read_result
from renet.evaluation.benchmark.scores import EpisodeRow, rows_of, score_rows
from renet.evaluation.benchmark.verify import check_origin, chosen_block, compare
from renet.evaluation.results import group_by, plain, write_json
from renet.evaluation.settings import Conditions
from renet.evaluation.study import Part, Study, Table
from renet.files import remove
from renet.motor_models import IDEAL

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator

_UNVERIFIED = ("out", "quick", "episodes", "method", "draw_seed", "jobs", "shard")
"""Settings that the verification of a result, which walks one block of it, has no use for."""


@dataclass(frozen=True)
class BenchmarkStudy(Study, PolicyOptions):
    """Count the obstacles that robots cross while the camera fails: renet-faults, version 3."""

    out: Path = Path("results/benchmark")
    """Folder for summary.md, summary.json, summary.csv, result.json and parts/."""
    quick: bool = False
    """Walk only the first 20 of the 200 episodes; such results are ranked among themselves."""
    # Hidden, because every episode has its own: see `unused`.
    seed: tyro.conf.Suppress[int] = 1
    conditions: tyro.conf.Suppress[Conditions] = "nominal"
    motors: tyro.conf.Suppress[str] = IDEAL
    entries: tuple[EntryName, ...] = ()
    """Ways to use the models; by default memory, switch, camera, blind and healthy. A policy with
    an adapter walks as camera and healthy, or as blind if it reads no image."""
    episodes: int | None = None
    """Walk only the first N of the 200 episodes, a multiple of 10, to see whether a policy walks at
    all; such results are not ranked, and there is no result.json."""
    method: str | None = None
    """Name of the method in the leaderboard, the same for its trainings; by default the policy's
    own name."""
    sealed: Path | None = None
    """The file of sealed families: walk the episodes with sealed faults instead."""
    draw_seed: int = SEED
    """Seed of the episodes. Another one is for experiments, and leaves no result.json."""
    verify: Path | None = None
    """A result.json of the same policy: walk ten of its episodes again, compare, and write
    nothing."""

    name: ClassVar[str] = "benchmark"
    selectable: ClassVar[tuple[str, ...]] = ("quick", "episodes", "method", "verify")
    unused: ClassVar[tuple[str, ...]] = ("seed", "conditions", "motors")

    def __post_init__(self) -> None:
        super().__post_init__()
        known = get_args(EntryName)
        if unknown := {*self.entries} - {*known}:
            raise RenetError(f"unknown entry {unknown.pop()!r}: choose among {', '.join(known)}")
        if self.verify is not None and (useless := self.changed(_UNVERIFIED)):
            raise RenetError(f"--verify walks ten episodes of a result: leave out {useless}")
        self.check_policy(self.bundle)
        if self.draw_seed < 0:
            raise RenetError(f"draw seed must be at least 0, got {self.draw_seed}")
        if self.sealed is not None and self.quick:
            raise RenetError("give --sealed or --quick, not both")
        if self.sealed is not None and self.draw_seed != SEED:
            raise RenetError(
                f"episodes of seed {self.draw_seed} are not those of version {BENCHMARK_VERSION}"
            )
        self._check_episodes()

    def _check_episodes(self) -> None:
        """Raise RenetError for a number of episodes that makes no whole blocks, or for another set.

        The robots of a block walk, and are drawn, together.
        """
        if self.episodes is None:
            return
        whole = self.episodes % EPISODES_PER_BLOCK == 0
        if not (whole and 0 < self.episodes <= EPISODES):
            raise RenetError(
                f"--episodes must be a multiple of {EPISODES_PER_BLOCK} up to {EPISODES}, got"
                f" {self.episodes}"
            )
        if self.quick or self.sealed is not None:
            raise RenetError("give --episodes without --quick and --sealed")

    def make_evaluator(self) -> Evaluator:
        """Make the evaluator of the bundle, or of another project's policy."""
        evaluator = self.open_policy(self.engine)
        if evaluator is None:
            return super().make_evaluator()
        # Raises for entries that the policy does not have.
        _ = self.modes(evaluator)
        return evaluator

    def modes(self, evaluator: Evaluator) -> dict[str, str]:
        """Return the rollout's mode of each entry to walk, by the entry's name.

        The evaluator of another project's policy names its own in `entries`. Raises RenetError for
        an entry that the policy does not have.
        """
        known: dict[str, str] = getattr(evaluator, "entries", ROLLOUT_MODES)
        names = self.entries
        if not names:
            names = DEFAULT_ENTRIES if known is ROLLOUT_MODES else tuple(known)
        if unknown := {*names} - {*known}:
            raise RenetError(
                f"this policy has no entry {unknown.pop()}: leave out --entries, or choose among"
                f" {', '.join(known)}"
            )
        return {name: known[name] for name in names}

    @property
    def episode_set(self) -> str:
        """The set of episodes to walk: a key of `SETS`, or words for the first ones of them."""
        if self.episodes is not None:
            return f"first {self.episodes}"
        if self.sealed is not None:
            return "sealed"
        return "quick" if self.quick else "full"

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """Return one part for each block of ten episodes."""
        numbers = SETS[self.episode_set] if self.episodes is None else range(self.episodes)
        parts = {}
        for first in range(numbers.start, numbers.stop, EPISODES_PER_BLOCK):
            parts[f"episodes_{first:03d}"] = partial(self.walk_block, evaluator, first)
        return parts

    def walk_block(self, evaluator: Evaluator, first: int) -> Part:
        """Walk a block of episodes, beginning with the number `first`."""
        from renet.evaluation.benchmark.walking import walk_episodes

        sealed = SealedFaults(self.sealed) if self.sealed else None
        episodes = draw_episodes(range(first, first + EPISODES_PER_BLOCK), self.draw_seed, sealed)
        modes = self.modes(evaluator)
        title = f"episodes {first} to {first + EPISODES_PER_BLOCK - 1}"
        # Each block draws its own bodies.
        seed = 1000 * self.draw_seed + first
        walks = walk_episodes(evaluator, episodes, modes, seed, title, sealed)
        return {"rows": rows_of(walks, episodes)}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """Return a row for every episode of every entry, and the entries' scores."""
        rows: list[EpisodeRow] = []
        for part in parts.values():
            rows += part["rows"]
        # By entry, each with the episodes of all blocks.
        runs: list[EpisodeRow] = []
        scores = {}
        for (entry,), group in group_by(rows, "entry").items():
            runs += group
            scores[entry] = score_rows(group)
        return {"runs": runs, "scores": scores, "robot": evaluator.robot.name}

    def run(self, evaluator: Evaluator | None = None) -> dict[str, Any]:
        """Run the study; writes result.json as well for one of the version's sets of episodes."""
        summary = super().run(evaluator)
        # A result.json of an earlier run would not be of this one.
        remove(self.out / "result.json")
        if self.draw_seed == SEED and self.episodes is None:
            write_json(self.out / "result.json", self._result(summary))
        return summary

    def _result(self, summary: Mapping[str, Any]) -> dict[str, Any]:
        """Build the content of the result file."""
        method = self.method or summary["provenance"]["bundle"]
        return make_result(summary, method, self.episode_set)

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """Tabulate scores, other measures, counts, and the scores under each family of faults."""
        result = self._result(summary)
        return [ranking([result]), measures([result]), counts(result), family_table(result)]

    def main(self) -> str | None:
        """Run the study and print its tables, or verify a result; raises RenetError if it fails.

        Returns:
            The verdict on a result, for the command line to print in place of the folder.
        """
        if self.verify is None:
            return super().main()
        return self.verify_result(self.verify)

    def verify_result(self, path: Path) -> str:
        """Walk a block of a result again; returns a sentence with the number of walks that agree.

        Raises RenetError if the result is of another policy, or does not agree.
        """
        result = read_result(path)
        evaluator = self.make_evaluator()
        sha256 = evaluator.provenance(self.seed).bundle_hash
        check_origin(result, path, sha256, self.sealed is not None, list(self.modes(evaluator)))
        block = self.walk_block(evaluator, chosen_block(result))
        return compare(result, path, plain(block)["rows"])
