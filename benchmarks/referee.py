"""Export a checkpoint's blind policy to one TorchScript file: `python benchmarks/referee.py`.

The module keeps the history and OP's memory of one robot, so that programs which load a policy with
`torch.jit.load`, such as RoboGauge, can walk it: `forward` takes an observation [1, 45] in every
control step and returns the action [1, 12]; `reset` begins a new walk. Its actions are those of the
pilot in the mode `blind`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
from torch import Tensor, nn

from facts import errors_in_one_line
from renet.files import write_atomically
from renet.interface import LATENT, PROPRIOCEPTION_SIZE, STEPS_PER_TICK
from renet.models.renet import RENet
from renet.tasks.entity import ACTION_CLIP
from renet.training import checkpoint as checkpoints
from renet.training.export import load_networks


@dataclass(frozen=True)
class Cfg:
    """Export the blind policy of a checkpoint."""

    checkpoint: tyro.conf.Positional[Path] = Path("benchmarks/go2")
    """Checkpoint, or a folder with one."""
    out: Path = Path("go2_blind.pt")
    """TorchScript file."""


class BlindTick(nn.Module):
    """OP's 10 Hz tick: history [1, H1, 45] and latent [1, 64] to the next latent [1, 64]."""

    def __init__(self, model: RENet) -> None:
        super().__init__()
        self.op = model.op

    def forward(self, history: Tensor, latent: Tensor) -> Tensor:
        """Advance OP's latent."""
        # OP does not read images.
        image = torch.zeros(1)
        return self.op(history, image, image, latent)


class BlindActor(nn.Module):
    """The actor on OP's latent: observation [1, 45] and latent [1, 64] to the action [1, 12]."""

    def __init__(self, model: RENet) -> None:
        super().__init__()
        self.actor = model.actor

    def forward(self, observation: Tensor, latent: Tensor) -> Tensor:
        """Compute the mean action, clipped as in training."""
        # VP's half of the actor's latent is masked (paper, eq. 3).
        fused = torch.cat((latent, torch.zeros_like(latent)), dim=-1)
        return self.actor(observation, fused).clamp(-ACTION_CLIP, ACTION_CLIP)


class BlindPolicy(nn.Module):
    """Blind policy of one robot, with its memory."""

    def __init__(self, model: RENet) -> None:
        super().__init__()
        # So that the memory of a long walk holds no graph of gradients.
        model = model.requires_grad_(False)
        history = torch.zeros(1, model.cfg.history, PROPRIOCEPTION_SIZE)
        latent = torch.zeros(1, LATENT)
        self.tick = torch.jit.trace(BlindTick(model), (history, latent))
        self.actor = torch.jit.trace(BlindActor(model), (history[:, 0], latent))
        self.steps_per_tick = STEPS_PER_TICK
        self.step = 0
        self.register_buffer("history", history)
        self.register_buffer("latent", latent)

    def forward(self, observation: Tensor) -> Tensor:
        """Act for one control step: observation o_t [1, 45] to the action [1, 12]."""
        past = self.history[:, 1:]
        # The first observation after a reset fills the history.
        if self.step == 0:
            past = observation.unsqueeze(1).expand_as(past)
        self.history = torch.cat((past, observation.unsqueeze(1)), dim=1)
        if self.step % self.steps_per_tick == 0:
            self.latent = self.tick(self.history, self.latent)  # pyright: ignore[reportCallIssue]
        self.step += 1
        return self.actor(observation, self.latent)  # pyright: ignore[reportCallIssue]

    @torch.jit.export
    def reset(self) -> None:
        """Begin a new walk."""
        self.step = 0
        self.latent = torch.zeros_like(self.latent)


def main(cfg: Cfg) -> Path:
    """Write the TorchScript file; returns its path."""
    model = load_networks(checkpoints.find(cfg.checkpoint))
    policy = torch.jit.script(BlindPolicy(model))
    write_atomically(cfg.out, policy.save_to_buffer(), "policy")
    return cfg.out


if __name__ == "__main__":
    with errors_in_one_line():
        print(main(tyro.cli(Cfg)))
