"""Verification of a result by ten of its episodes: `renet evaluate benchmark --verify FILE`."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, Protocol

from renet.errors import RenetError, printable
from renet.evaluation.benchmark.episodes import EPISODES_PER_BLOCK
from renet.evaluation.benchmark.results import SETS, read_result
from renet.evaluation.results import plain

_EXACT = ("obstacles", "crossed", "fell", "arrived")
"""Measures that must be equal for an episode to agree."""
_TOLERATED = 0.1
"""Share of the rows that may differ: processors round differently, and falls are sensitive to
it."""


class Verifiable(Protocol):
    """Study whose result can be verified; `BenchmarkStudy` is one."""

    @property
    def seed(self) -> int:
        """Seed in the provenance."""
        ...

    @property
    def sealed(self) -> Path | None:
        """The file of sealed families."""
        ...

    def make_evaluator(self) -> Any:
        """The evaluator of the policy."""
        ...

    def modes(self, evaluator: Any) -> dict[str, str]:
        """The rollout's mode of each entry."""
        ...

    def walk(self, evaluator: Any, first: int) -> dict[str, Any]:
        """The rows of a block of episodes."""
        ...


def chosen_block(result: dict[str, Any]) -> int:
    """First number of the block to walk again, chosen by a hash of the whole result."""
    numbers = SETS[result["episodes"]]
    digest = hashlib.sha256(repr(result["rows"]).encode()).digest()
    blocks = range(numbers.start, numbers.stop, EPISODES_PER_BLOCK)
    return blocks[int.from_bytes(digest[:8]) % len(blocks)]


def _check_origin(result: dict[str, Any], path: Path, sha256: str, sealed: bool) -> None:
    """Raise RenetError if a result is of another policy, or of another kind of episodes."""
    if sha256 != result["policy"]["sha256"]:
        raise RenetError(
            printable(
                f"{path} is of the policy {result['policy']['sha256'][:12]}…, this is"
                f" {sha256[:12]}…: give the --bundle, or the --policy, of the result"
            )
        )
    if (result["episodes"] == "sealed") != sealed:
        raise RenetError(
            f"{printable(str(path))}: give --sealed for sealed episodes, and only then"
        )


def verify(study: Verifiable, path: Path) -> str:
    """Walk a block of a result again; returns a sentence with the number of walks that agree.

    Raises RenetError if the result is of another policy, or does not agree.
    """
    result = read_result(path)
    evaluator = study.make_evaluator()
    sha256 = evaluator.provenance(study.seed).bundle_hash
    _check_origin(result, path, sha256, study.sealed is not None)
    # Only entries that both the result and this policy have can be compared.
    first = chosen_block(result)
    walked_entries = study.modes(evaluator)
    entries = [entry for entry in walked_entries if entry in result["scores"]]
    if not entries:
        raise RenetError(
            f"{printable(str(path))} has none of the entries {', '.join(walked_entries)}"
        )
    new_rows = plain(study.walk(evaluator, first))["rows"]
    new_by_walk = {(row["entry"], row["episode"]): row for row in new_rows}
    # Compare the result's rows of this block with the new ones.
    last = first + EPISODES_PER_BLOCK - 1
    old_rows = []
    differ = []
    for row in result["rows"]:
        if row["entry"] not in entries or not first <= row["episode"] <= last:
            continue
        old_rows.append(row)
        other = new_by_walk[row["entry"], row["episode"]]
        if any(row[name] != other[name] for name in _EXACT):
            differ.append(row)
    if len(differ) > _TOLERATED * len(old_rows):
        worst = differ[0]
        raise RenetError(
            f"{printable(str(path))} does not hold: of episodes {first} to {last},"
            f" {len(differ)} of {len(old_rows)} walks end otherwise, the first in episode"
            f" {worst['episode']} ({printable(worst['entry'])})"
        )
    return (
        f"{printable(str(path))} holds: of episodes {first} to {last},"
        f" {len(old_rows) - len(differ)} of {len(old_rows)} walks end as the file says"
    )
