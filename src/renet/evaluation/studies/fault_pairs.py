"""What a fault is to blame for: every robot compared with itself, not crowds with crowds.

Robots fall over obstacles with healthy cameras, too. Each row of a fault's batch has a twin in the
batch without faults: same mode, body, start, camera and noise, alike to the bit until the onset.
Only a fall that the twin does not have can be the fault's, and because a walk over obstacles is
chaotic, twins part company by chance, in both directions: what counts is how much more often the
one happens than the other (sign test, McNemar 1947).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy import stats

from renet.evaluation.metrics import bootstrap_interval

CHANCE = 0.05
"""Probability below which a difference is not put down to chance."""

Runs = list[dict[str, Any]]


def paired_runs(
    part: dict[str, Any], usual: dict[str, Any], modes: Sequence[str], robots: int
) -> Runs:
    """The rows of one fault with what their pairs say.

    Args:
        part: of the fault: `runs`, and `fell`, one number for each row of its batch.
        usual: of the same ground without faults: `fell`.
        modes: in the order of the batch. robots: in each setting.

    Returns:
        Rows with `falls_by_fault` (fell, the twin did not) and `falls_spared` (the other way
        round); those of RENet also with `only_op_upright`, `only_renet_upright` and the difference
        in survival to OP, robot by robot, with its interval.
    """
    fell, calm = (
        np.reshape(p["fell"], (-1, len(modes), robots)).astype(bool) for p in (part, usual)
    )
    rows = []
    for number, run in enumerate(part["runs"]):
        severity, mode = divmod(number, len(modes))
        mine, twin = fell[severity, mode], calm[severity, mode]
        row = {
            "falls_by_fault": int((mine & ~twin).sum()),
            "falls_spared": int((twin & ~mine).sum()),
        }
        against_op = run["mode"] == "renet" and "op" in modes
        other = fell[severity, list(modes).index("op")] if against_op else None
        rows.append(run | row | _beside_op(mine, other))
    return rows


def _beside_op(fell: np.ndarray, op_fell: np.ndarray | None) -> dict[str, Any]:
    """How RENet's robots fare beside the same robots under OP; all None without them."""
    names = ("only_op_upright", "only_renet_upright", "over_op", "over_op_ci95_low")
    if op_fell is None:
        return dict.fromkeys((*names, "over_op_ci95_high"))
    gain = op_fell.astype(float) - fell
    low, high = bootstrap_interval(gain)
    return {
        "only_op_upright": int((gain < 0).sum()),
        "only_renet_upright": int((gain > 0).sum()),
        "over_op": float(gain.mean()),
        "over_op_ci95_low": low,
        "over_op_ci95_high": high,
    }


def sign_test(more: int, fewer: int) -> float:
    """Probability of `more` heads or still more among more + fewer tosses of a fair coin."""
    tosses = more + fewer
    return float(stats.binomtest(more, tosses, alternative="greater").pvalue) if tosses else 1.0


def beyond_chance(pairs: Iterable[tuple[int, int]], calm: bool) -> bool:
    """Whether one thing happens more often than its opposite, all pairs of counts together.

    Args:
        pairs: (more, fewer) of each setting.
        calm: nothing ever happens to healthy robots there: then once is enough.
    """
    more, fewer = (sum(counts) for counts in zip((0, 0), *pairs, strict=True))
    return more > fewer and (calm or sign_test(more, fewer) < CHANCE)
