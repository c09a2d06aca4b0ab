"""Options of commands that take another project's policy: `--policy FILE --adapter NAME`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from renet.errors import RenetError

if TYPE_CHECKING:
    from renet.evaluation.adapters.evaluator import AdaptedEvaluator


@dataclass(frozen=True, kw_only=True)
class PolicyOptions:
    """Base of settings with a policy of another project in place of a bundle."""

    policy: Path | None = None
    """Model of another project, .onnx or TorchScript (.pt), in place of a bundle."""
    adapter: str | None = None
    """Adapter for its inputs and outputs: onnx-depth, extreme-parkour, playground, himloco,
    robogauge, robot-lab, or a FILE.py of your own (docs/benchmark.md)."""

    def check_policy(self, bundle: Path | None) -> None:
        """Raise RenetError if a policy lacks its adapter, or comes with a bundle."""
        if (self.policy is None) != (self.adapter is None):
            raise RenetError(
                "give --policy FILE and --adapter together: a name of docs/benchmark.md, or FILE.py"
            )
        if self.policy is not None and bundle is not None:
            raise RenetError("give --policy or --bundle, not both")

    def open_policy(self, engine: str) -> AdaptedEvaluator | None:
        """Open the policy in nominal conditions; None if none is given.

        Raises RenetError if the file or the adapter cannot be used.
        """
        if self.policy is None or self.adapter is None:
            return None
        # It loads PyTorch and mjlab, which take seconds.
        from renet.evaluation.adapters.evaluator import AdaptedEvaluator

        # Films have no others, and the benchmark sets its own.
        return AdaptedEvaluator(self.policy, self.adapter, engine, conditions="nominal")
