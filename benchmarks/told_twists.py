"""Turn a policy that is told a heading into one that is told a velocity and a turn rate.

The first layers that read (c_x, sin e, cos e) come to read (v_x, v_y, omega_z), so that the policy
walks ahead and turns as before: a robot off its heading by e is told the turn rate TURN_GAIN e. It
does not know sideways and backward yet. `renet train --resume OUT` goes on from it, with the
settings of the code (benchmarks/NOTES.md, Learning to be driven).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
import tyro
from rsl_rl.modules import EmpiricalNormalization
from torch import Tensor

from facts import errors_in_one_line
from renet.interface import HISTORY, PROPRIOCEPTION_SIZE, TURN_GAIN, proprioception_slices
from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.options import TASK
from renet.training import checkpoint as checkpoints
from renet.training.config import from_dict
from renet.training.train import TrainCfg

COMMAND = proprioception_slices()["command"].start
"""Column of the first of three numbers of the command."""
TWIST_STD = (0.2, 0.4)
"""Deviations of v_y and omega_z by which the critics' inputs are divided at first."""


@dataclass(frozen=True)
class Cfg:
    """Turn a policy that is told a heading into one that is told a twist."""

    checkpoint: tyro.conf.Positional[Path] = Path("src/renet/pretrained/checkpoint")
    """Checkpoint, or a folder with one."""
    out: Path = Path("twist")
    """Folder of the new checkpoint."""
    exploration: float = 0.33
    """Least deviation of the actions."""


def read_twist(weight: Tensor, bias: Tensor, *columns: int) -> None:
    """Let a layer read (v_x, v_y, omega_z) where it read (c_x, sin e, cos e), in place.

    Args:
        weight: [outputs, inputs].
        bias: [outputs].
        columns: of c_x, once for each proprioception among the inputs.
    """
    for column in columns:
        sine = weight[:, column + 1].clone()
        # Near its heading a robot reads cos e = 1.
        bias += weight[:, column + 2]
        weight[:, column + 1] = 0.0
        weight[:, column + 2] = sine / TURN_GAIN


def read_normalised_twist(weight: Tensor, bias: Tensor, mean: Tensor, std: Tensor) -> None:
    """The same of a critic's first layer, whose inputs are normalised by mean and deviation."""
    epsilon = EmpiricalNormalization(1).eps
    std = std + epsilon
    sine = weight[:, COMMAND + 1] / std[COMMAND + 1]
    cosine = weight[:, COMMAND + 2] / std[COMMAND + 2]
    bias += cosine * (1.0 - mean[COMMAND + 2]) - sine * mean[COMMAND + 1]
    weight[:, COMMAND + 1] = 0.0
    weight[:, COMMAND + 2] = sine / TURN_GAIN * (TWIST_STD[1] + epsilon)


def told_twists(weights: dict[str, Tensor], exploration: float) -> dict[str, Tensor]:
    """A copy of a model's weights, by name, for a policy that is told twists."""
    weights = {name: tensor.clone().float() for name, tensor in weights.items()}
    history = [PROPRIOCEPTION_SIZE * past + COMMAND for past in range(HISTORY)]
    layers = {"actor.mean.0": [COMMAND]}
    for estimator in ("op", "vp"):
        layers[f"{estimator}.proprioception.1"] = history
        layers[f"{estimator}_him.target.0"] = [COMMAND]
    for layer, columns in layers.items():
        read_twist(weights[f"{layer}.weight"], weights[f"{layer}.bias"], *columns)
    mean = weights["critic_normalizer._mean"][0]
    std = weights["critic_normalizer._std"][0]
    for name in [name for name in weights if name.startswith("critics.")]:
        if name.endswith("0.weight") and weights[name].shape[1] == len(mean):
            bias = weights[name.replace("weight", "bias")]
            read_normalised_twist(weights[name], bias, mean, std)
    mean[COMMAND + 1 : COMMAND + 3] = 0.0
    std[COMMAND + 1 : COMMAND + 3] = torch.tensor(TWIST_STD)
    weights["critic_normalizer._var"] = std.square()[None]
    # Of the steps so far as many count as the normaliser can still move away from.
    weights["critic_normalizer.count"] = torch.tensor(20_000_000)
    weights["actor.log_std"] = weights["actor.log_std"].clamp_min(math.log(exploration))
    return weights


def main(cfg: Cfg) -> Path:
    """Write the new checkpoint; returns its folder."""
    folder = checkpoints.find(cfg.checkpoint)
    before = checkpoints.load_checkpoint(folder)
    agent = TrainCfg.from_task(TASK).agent
    weights = told_twists(before.model, cfg.exploration)
    # Heads that the checkpoint lacks begin anew.
    critic_size = weights["critics.reward.0.weight"].shape[1]
    model = RENet(from_dict(ModelCfg, asdict(agent.model)), critic_size)
    model.load_state_dict(weights, strict=False)
    state = before.state | {"env": {}, "agent": asdict(agent), "averaged": 1}
    after = checkpoints.Checkpoint(
        model=model.state_dict(), optimizer={}, environment=before.environment, state=state
    )
    return checkpoints.save(after, cfg.out, state["iteration"], keep=1)


if __name__ == "__main__":
    with errors_in_one_line():
        print(main(tyro.cli(Cfg)))
