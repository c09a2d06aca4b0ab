"""A checkpoint as a policy of the studies, also one that cannot be exported."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import torch

from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import Provenance
from renet.interface import STEPS_PER_TICK
from renet.models.adaptation import fuse
from renet.models.memory import EstimatorMemory
from renet.models.renet import RENet
from renet.tasks.robot_cfg import ACTION_CLIP
from renet.training import checkpoint as checkpoints
from renet.training.export import load_networks


class CheckpointPolicy:
    """A checkpoint's actor and estimators in torch, with the simulator's truth for the Oracle."""

    def __init__(self, model: RENet, evaluator: CheckpointEvaluator, num_robots: int) -> None:
        self._model, self._evaluator = model, evaluator
        self.anomaly_score = np.zeros(num_robots)
        self.reset()

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Forget the past of the masked robots [N], of all by default."""
        if mask is None:
            self._memory = EstimatorMemory(self._model.cfg, len(self.anomaly_score), "cpu")
            self._steps = 0
        else:
            self._memory.reset(torch.from_numpy(mask))

    @torch.no_grad()
    def step(
        self, proprioception: np.ndarray, depth: np.ndarray, op_mask: np.ndarray
    ) -> np.ndarray:
        """Mean actions [N, 12]; estimators tick at 10 Hz."""
        sensed = torch.from_numpy(proprioception)
        self._memory.push(sensed)
        if self._steps % STEPS_PER_TICK == 0:
            self._memory.see(torch.from_numpy(depth))
            self._memory.tick(self._model.advance)
        self._steps += 1
        if self._model.cfg.perception == "oracle":
            truth = self._evaluator.env.observation
            latent = torch.cat((truth["height_map"], truth["velocity"]), dim=-1)
        else:
            memory = self._memory
            latent = fuse(memory.latent_op, memory.latent_vp, torch.from_numpy(op_mask))
        return self._model.actor(sensed, latent.float()).clamp(-ACTION_CLIP, ACTION_CLIP).numpy()


class CheckpointEvaluator(Evaluator):
    """Judges a checkpoint, also one that cannot be exported."""

    privileged = ("height_map", "velocity")

    def __init__(self, path: Path) -> None:
        """Load a checkpoint; raises RenetError where it is damaged."""
        super().__init__()
        self._model = load_networks(path)
        self._name = path.name
        digest = hashlib.sha256()
        for name, value in sorted(checkpoints.load(path).exported.items()):
            digest.update(name.encode() + value.numpy().tobytes())
        self._digest = digest.hexdigest()

    def make_policy(self, num_robots: int) -> CheckpointPolicy:
        """The policy for N robots of the newest environment."""
        return CheckpointPolicy(self._model, self, num_robots)

    def provenance(self, seed: int) -> Provenance:
        """The checkpoint's name and hash in place of a bundle's."""
        return Provenance(self._name, self._digest, "native", seed)
