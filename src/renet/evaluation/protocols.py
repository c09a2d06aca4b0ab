"""What a rollout needs of an environment, a policy and a selector, whoever wrote them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from renet.errors import RenetError
from renet.evaluation.trace import TrueState
from renet.faults import ViewPerturbation
from renet.selector.monitors import Gate, SelectorInput


@dataclass(frozen=True)
class StepResult(TrueState):
    """What N robots sense and truly do after a control step."""

    proprioception: np.ndarray
    """[N, 45]"""
    depth: np.ndarray
    """[N, 48, 64] normalised, held between the camera's ticks."""
    angular_velocity: np.ndarray
    """[N, 3] true base rate, rad/s, base frame."""


class EvalEnv(Protocol):
    """A batch of simulated robots."""

    num_robots: int

    def reset(self) -> StepResult:
        """Put every robot at its start."""
        ...

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step."""
        ...

    def poses(self, rows: Sequence[int]) -> np.ndarray:
        """Generalised positions [len(rows), nq], for pictures."""
        ...

    def perturb_cameras(self, view: ViewPerturbation) -> None:
        """Let the cameras see the scene so from their next image on: physical faults."""


class EvalPolicy(Protocol):
    """Anybody's policy: `renet.bundle.policy.Policy` is one.

    Further attributes are optional. The selector's monitors compare `velocity_op` and `velocity_vp`
    ([N, 3] m/s) and judge `variance_score` ([N]). A policy with `has_image` ([N] bool) can do
    without an image: its `step` takes a `gate` as well.
    """

    anomaly_score: np.ndarray
    """[N] how unlike its training images the last frames were; any scale."""

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the past of the masked robots [N], of all by default."""

    def step(
        self, proprioception: np.ndarray, depth: np.ndarray, op_mask: np.ndarray
    ) -> np.ndarray:
        """Actions [N, 12]; `op_mask` is the paper's mask, True where OP is to act."""
        ...


class EvalSelector(Protocol):
    """Decides whether to trust vision."""

    @property
    def probability(self) -> np.ndarray:
        """[N] vision probability P_t."""
        ...

    def look(self, seen: SelectorInput) -> Gate | None:
        """Once each tick, before the policy acts: which images it may use; None: all."""
        ...

    def update(self, seen: SelectorInput, now: float) -> np.ndarray:
        """Once each physics step, at `now` s; returns [N] bool, vision is trusted."""
        ...

    def reset(self, mask: np.ndarray) -> None:
        """Start anew for the masked robots [N]."""


def demand_shapes(path: Path, nodes: Sequence[Any], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse somebody's ONNX policy that takes or gives anything else than the caller handles.

    Args:
        path: of the model.
        nodes: its inputs and outputs, of an ONNX Runtime session.
        shapes: the shape of each for one robot, by name; the model must take N robots.

    Raises:
        RenetError: other names, other shapes, or a fixed number of robots.
    """
    present = {node.name: list(node.shape) for node in nodes}
    batched = all(shape and not isinstance(shape[0], int) for shape in present.values())
    if {name: tuple(shape[1:]) for name, shape in present.items()} != shapes or not batched:
        raise RenetError(
            f"{path} has {', '.join(f'{name} {shape}' for name, shape in present.items())}; a study"
            " gives proprioception [N, 45] (no base velocity) and depth [N, 48, 64] in [0, 1], and"
            " holds the joint targets of actions [N, 12] with gains 40 and 1: compute what else the"
            " model needs in the policy's `step` (docs/evaluation.md, Your own policy)"
        )
