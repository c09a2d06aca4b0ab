"""`renet evaluate benchmark`: a policy on the episodes of renet-faults, version 3."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, get_args

from renet.errors import RenetError
from renet.evaluation.benchmark.episodes import BLOCK, SEED, draw_episodes
from renet.evaluation.benchmark.families import SealedFaults
from renet.evaluation.benchmark.leaderboard import family_table, measures, ranking
from renet.evaluation.benchmark.modes import DEFAULT_ENTRIES, MODES, EntryName
from renet.evaluation.benchmark.results import SETS, demand_version_seed, make_result
from renet.evaluation.benchmark.scores import Row, by_family, rows_of, score
from renet.evaluation.results import grouped, write_json
from renet.evaluation.study import Part, Study, Table
from renet.files import remove
from renet.motor_models import IDEAL

if TYPE_CHECKING:
    from renet.evaluation.evaluator import Evaluator


@dataclass(frozen=True)
class BenchmarkStudy(Study):
    """Who crosses what, while the camera fails on the way: renet-faults, version 3."""

    out: Path = Path("results/benchmark")
    """Folder for summary.md, summary.json, summary.csv, result.json and parts/."""
    policy: Path | None = None
    """Somebody else's model, .onnx or TorchScript (.pt), in place of a bundle."""
    adapter: str | None = None
    """What its inputs and outputs mean: onnx-depth, playground, himloco, robogauge, robot-lab, or a
    FILE.py of your own (docs/benchmark.md)."""
    entries: tuple[EntryName, ...] = ()
    """Ways to use the models; by default memory, switch, camera, blind and healthy, of a policy
    with an adapter camera and healthy, or blind if it sees no image."""
    method: str | None = None
    """What the policy is a training of, in the leaderboard; by default its own name."""
    sealed: Path | None = None
    """The file of sealed families: walk the episodes with their faults instead."""
    draw_seed: int = SEED
    """Of the episodes. Another one is for trying things out, and leaves no result.json."""
    verify: Path | None = None
    """A result.json of the same policy: walk ten of its episodes again, and compare."""

    name: ClassVar[str] = "benchmark"
    selectable: ClassVar[tuple[str, ...]] = ("quick", "method", "verify")

    def __post_init__(self) -> None:
        super().__post_init__()
        known = get_args(EntryName)
        if len({*self.entries}) < len(self.entries):
            raise RenetError("entries: give each of them once")
        if unknown := {*self.entries} - {*known}:
            raise RenetError(f"unknown entry {unknown.pop()!r}: choose among {', '.join(known)}")
        if self.conditions != "nominal" or self.motors != IDEAL:
            raise RenetError(
                "the benchmark has conditions and motors of its own: leave out --conditions and"
                " --motors"
            )
        self._check_policy()
        if self.draw_seed < 0:
            raise RenetError(f"draw seed must be at least 0, got {self.draw_seed}")
        if self.sealed is not None and self.quick:
            raise RenetError("give --sealed or --quick, not both")
        if self.sealed is not None:
            demand_version_seed(self.draw_seed)

    def _check_policy(self) -> None:
        """Raise RenetError unless a policy and its adapter are given together, without a bundle."""
        if (self.policy is None) != (self.adapter is None):
            raise RenetError("give --policy FILE and --adapter NAME together")
        if self.policy is not None and self.bundle is not None:
            raise RenetError("give --policy or --bundle, not both")

    def make_evaluator(self) -> Evaluator:
        """The evaluator of the bundle, or of somebody else's policy."""
        if self.policy is None or self.adapter is None:
            return super().make_evaluator()
        from renet.evaluation.adapters.evaluator import AdaptedEvaluator

        evaluator = AdaptedEvaluator(self.policy, self.adapter, self.engine)
        _ = self.modes(evaluator)
        return evaluator

    def modes(self, evaluator: Evaluator) -> dict[str, str]:
        """The rollout's mode of each entry to walk, by the entry's name.

        An evaluator of another policy names its own in `entries`. Raises RenetError for an entry
        that the policy does not have.
        """
        known: dict[str, str] = getattr(evaluator, "entries", MODES)
        names = self.entries or (DEFAULT_ENTRIES if known is MODES else tuple(known))
        if unknown := {*names} - {*known}:
            raise RenetError(
                f"this policy has no entry {unknown.pop()}: leave out --entries, or choose among"
                f" {', '.join(known)}"
            )
        return {name: known[name] for name in names}

    @property
    def episodes(self) -> str:
        """The set of episodes to walk, a key of `SETS`."""
        if self.sealed is not None:
            return "sealed"
        return "quick" if self.quick else "full"

    def parts(self, evaluator: Evaluator) -> Mapping[str, Callable[[], Part]]:
        """One part for each block of ten episodes."""
        numbers = SETS[self.episodes]
        return {
            f"episodes_{first:03d}": partial(self.walk, evaluator, first)
            for first in range(numbers.start, numbers.stop, BLOCK)
        }

    def walk(self, evaluator: Evaluator, first: int) -> Part:
        """Walk a block of episodes, from the number `first` on."""
        from renet.evaluation.benchmark.walking import walk_episodes

        sealed = SealedFaults(self.sealed) if self.sealed else None
        episodes = draw_episodes(range(first, first + BLOCK), self.draw_seed, sealed)
        modes = self.modes(evaluator)
        title = f"episodes {first} to {first + BLOCK - 1}"
        # A block's bodies are its own.
        seed = 1000 * self.draw_seed + first
        walks = walk_episodes(evaluator, episodes, modes, seed, title, sealed)
        return {"rows": rows_of(walks, episodes)}

    def summarise(self, parts: Mapping[str, Part], evaluator: Evaluator) -> dict[str, Any]:
        """A row for every episode of every entry, and the entries' scores."""
        rows: list[Row] = [row for part in parts.values() for row in part["rows"]]
        groups = {entry: group for (entry,), group in grouped(rows, "entry").items()}
        return {
            "runs": [row for group in groups.values() for row in group],
            "scores": {entry: score(group) for entry, group in groups.items()},
            "families": {entry: by_family(group) for entry, group in groups.items()},
            "robot": evaluator.robot.name,
        }

    def run(self, evaluator: Evaluator | None = None) -> dict[str, Any]:
        """As every study; writes result.json as well, if the episodes are the version's."""
        summary = super().run(evaluator)
        remove(self.out / "result.json")
        if self.draw_seed == SEED:
            write_json(self.out / "result.json", self._result(summary))
        return summary

    def _result(self, summary: Mapping[str, Any]) -> dict[str, Any]:
        method = self.method or summary["provenance"]["bundle"]
        return make_result(summary, method, summary["robot"], self.episodes)

    def tables(self, summary: dict[str, Any]) -> list[Table]:
        """The scores, the other measures, and what is crossed under each family of faults."""
        result = self._result(summary)
        return [ranking([result]), measures([result]), family_table(result)]

    def main(self) -> None:
        """Run the study and print its tables, or verify a result; raises RenetError if it fails."""
        if self.verify is None:
            super().main()
            return
        from renet.evaluation.benchmark.verify import verify

        print(verify(self, self.verify))
