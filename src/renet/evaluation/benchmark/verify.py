"""Verification of a result by ten of its episodes: `renet evaluate benchmark --verify FILE`."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from renet.errors import RenetError, printable
from renet.evaluation.benchmark.episodes import EPISODES_PER_BLOCK
from renet.evaluation.benchmark.results import SETS
from renet.evaluation.benchmark.scores import EpisodeRow
from renet.evaluation.results import column

_EXACT = ("obstacles", "crossed", "fell", "arrived")
"""Measures that must be equal for an episode to agree."""
_TOLERATED = 0.1
"""Share of the rows that may differ: processors round differently, and falls are sensitive to
it."""


def chosen_block(result: dict[str, Any]) -> int:
    """Choose the block to walk again by a hash of the whole result; returns its first number."""
    numbers = SETS[result["episodes"]]
    digest = hashlib.sha256(repr(result["rows"]).encode()).digest()
    blocks = range(numbers.start, numbers.stop, EPISODES_PER_BLOCK)
    return blocks[int.from_bytes(digest[:8]) % len(blocks)]


def check_origin(
    result: dict[str, Any], path: Path, sha256: str, sealed: bool, entries: Sequence[str]
) -> None:
    """Raise RenetError unless a policy can walk episodes of a result again.

    Args:
        result: Content of the result file.
        path: The file, for the message.
        sha256: Hash of the policy.
        sealed: True if the sealed families are at hand.
        entries: Entries that the policy walks as.
    """
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
    if not {*entries} & {*result["scores"]}:
        raise RenetError(f"{printable(str(path))} has none of the entries {', '.join(entries)}")


def compare(result: dict[str, Any], path: Path, rows: Sequence[EpisodeRow]) -> str:
    """Compare a result with the same walks made again; returns a sentence with those that agree.

    Args:
        result: Content of the result file.
        path: The file, for the sentence.
        rows: Rows of a block of its episodes; entries that the result lacks do not count. Raises
            RenetError if too many of the others differ.
    """
    made_again = {(row["entry"], row["episode"]): row for row in rows}
    compared = []
    differ = []
    for row in result["rows"]:
        other = made_again.get((row["entry"], row["episode"]))
        if other is None:
            continue
        compared.append(row)
        if any(row[name] != other[name] for name in _EXACT):
            differ.append(row)
    numbers = column(rows, "episode")
    episodes = f"of episodes {min(numbers)} to {max(numbers)}"
    if len(differ) > _TOLERATED * len(compared):
        worst = differ[0]
        raise RenetError(
            f"{printable(str(path))} does not hold: {episodes},"
            f" {len(differ)} of {len(compared)} walks end otherwise, the first in episode"
            f" {worst['episode']} ({printable(worst['entry'])})"
        )
    return (
        f"{printable(str(path))} holds: {episodes}, {len(compared) - len(differ)} of"
        f" {len(compared)} walks end as the file says"
    )
