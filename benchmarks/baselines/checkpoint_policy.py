"""A checkpoint as a policy of the studies and as a teacher, also one that cannot be exported."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import Provenance
from renet.evaluation.settings import Conditions
from renet.interface import STEPS_PER_TICK
from renet.models.adaptation import fuse
from renet.models.memory import EstimatorMemory
from renet.models.oracle import true_image
from renet.models.renet import RENet
from renet.motor_models import IDEAL
from renet.tasks.entity import ACTION_CLIP
from renet.training import checkpoint as checkpoints
from renet.training.export import load_networks


class RecurrentPolicy:
    """A model's estimators and actor, and what they remember of N robots."""

    def __init__(self, model: RENet, num_robots: int, device: Any = "cpu") -> None:
        self.model = model
        self.memory = EstimatorMemory(model.cfg, num_robots, device)
        self._steps = 0

    @torch.no_grad()
    def step(self, sensed: Tensor, depth: Tensor, height_map: Tensor, op_mask: Tensor) -> Tensor:
        """Mean actions [N, 12] after o_t [N, 45]; estimators tick at 10 Hz.

        VP sees depth [N, 48, 64], or the true height map [N, 132] if it is an Oracle's. OP steers
        where `op_mask` [N].
        """
        self.memory.push(sensed)
        if self._steps % STEPS_PER_TICK == 0:
            oracle = self.model.cfg.perception == "oracle"
            self.memory.see(true_image(height_map) if oracle else depth)
            self.memory.tick(self.model.advance)
        self._steps += 1
        latent = fuse(self.memory.latent_op, self.memory.latent_vp, op_mask)
        return self.model.actor(sensed, latent)


class CheckpointPolicy:
    """A checkpoint in torch, with the simulator's truth for the Oracle."""

    def __init__(self, model: RENet, evaluator: CheckpointEvaluator, num_robots: int) -> None:
        self._model, self._evaluator = model, evaluator
        self.anomaly_score = np.zeros(num_robots)
        self.reset()

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the past of the masked robots [N], of all by default."""
        if mask is None:
            self._policy = RecurrentPolicy(self._model, len(self.anomaly_score))
        else:
            self._policy.memory.reset(torch.from_numpy(mask))

    def step(
        self, proprioception: np.ndarray, depth: np.ndarray, op_mask: np.ndarray
    ) -> np.ndarray:
        """Mean actions [N, 12]."""
        seen = map(torch.from_numpy, (proprioception, depth))
        truth = self._evaluator.env.observation["height_map"]
        action = self._policy.step(*seen, truth, torch.from_numpy(op_mask))
        return action.clamp(-ACTION_CLIP, ACTION_CLIP).numpy()


class CheckpointEvaluator(Evaluator):
    """Judges a checkpoint, also one that cannot be exported."""

    privileged = ("height_map",)

    def __init__(
        self,
        path: Path,
        engine: str = "auto",
        conditions: Conditions = "training",
        motors: str = IDEAL,
    ) -> None:
        """Load a checkpoint; raises RenetError where it is damaged."""
        super().__init__(None, engine, conditions, motors)
        self._model = load_networks(path)
        self._name = path.name
        digest = hashlib.sha256()
        for name, value in sorted(checkpoints.load_checkpoint(path).exported.items()):
            digest.update(name.encode() + value.numpy().tobytes())
        self._digest = digest.hexdigest()

    def make_policy(self, num_robots: int) -> CheckpointPolicy:
        """The policy for N robots of the newest environment."""
        return CheckpointPolicy(self._model, self, num_robots)

    def provenance(self, seed: int) -> Provenance:
        """The checkpoint's name and hash in place of a bundle's."""
        return replace(super().provenance(seed), bundle=self._name, bundle_hash=self._digest)
