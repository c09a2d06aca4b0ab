"""Does HIM collapse? Its prototypes after learning at several temperatures, on recorded walks.

A policy walks over all tiles; an OP estimator and its HIM then learn from the recorded histories,
beside a velocity loss. A collapsed module has prototypes of rank 1 and finds no partner.
"""

from __future__ import annotations

import io
import warnings
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path

import torch
import tyro
from torch import Tensor
from torch.nn.functional import normalize

from facts import report
from renet.evaluation.env import terrain_env_cfg
from renet.models import him as him_module
from renet.models.actor_critic import fuse
from renet.models.config import ModelCfg
from renet.models.estimators import OPEstimator
from renet.models.him import HybridInternalModel, target_view
from renet.models.memory import EstimatorMemory
from renet.tasks import make_env
from renet.tasks.config.go1 import GO1
from renet.training import checkpoint as checkpoints
from renet.training.export import load_networks


@dataclass(frozen=True)
class Cfg:
    checkpoint: Path = Path(str(files("renet"))) / "pretrained" / "checkpoint"
    """Whose walks are recorded."""
    robots: int = 120
    seconds: float = 10.0
    temperatures: tuple[float, ...] = (3.0, 1.0, 0.3, 0.1)
    steps: int = 1500
    """Of Adam, at 1e-3."""
    batch: int = 512
    seed: int = 5
    json: Path | None = None
    """Write the results to this file."""


@torch.no_grad()
def record(cfg: Cfg) -> tuple[Tensor, Tensor, Tensor]:
    """Histories [B, 10, 45], velocities [B, 3] and what followed, as HIM's target sees it."""
    found = checkpoints.find(cfg.checkpoint)
    model = load_networks(checkpoints.load(found), found)
    with redirect_stdout(io.StringIO()), warnings.catch_warnings(action="ignore"):
        env = make_env(terrain_env_cfg("parkour", 1, GO1), cfg.robots, seed=cfg.seed)
    memory = EstimatorMemory(model.cfg, cfg.robots, "cpu")
    vision = torch.zeros(cfg.robots)
    obs, _ = env.reset()
    rows: list[tuple[Tensor, Tensor, Tensor]] = []
    for step in range(round(cfg.seconds / env.step_dt)):
        memory.push(obs["proprioception"])
        if tick := step % 5 == 0:
            memory.see(obs["depth"])
            memory.tick(model.advance)
            before = memory.history, obs["velocity"].clone()
        latent = fuse(memory.latent_op, memory.latent_vp, vision)
        obs, _, terminated, cut, _ = env.step(model.actor(obs["proprioception"], latent))
        done = terminated | cut
        if tick:
            following = target_view(obs["proprioception_clean"], obs["velocity"])
            rows.append((before[0][~done], before[1][~done], following[~done]))
        memory.reset(done)
    env.close()
    histories, velocities, followings = (torch.cat(column) for column in zip(*rows, strict=True))
    return histories, velocities, followings


def learn(cfg: Cfg, data: tuple[Tensor, ...], temperature: float) -> dict[str, float]:
    """What HIM has become after `cfg.steps` steps."""
    torch.manual_seed(cfg.seed)
    him_module.TEMPERATURE = temperature
    estimator, him = OPEstimator(ModelCfg()), HybridInternalModel()
    assert estimator.velocity_head is not None
    optimizer = torch.optim.Adam([*estimator.parameters(), *him.parameters()], lr=1e-3)
    latent_of = partial(estimator, depth=torch.empty(0), latent=torch.zeros(cfg.batch, 64))
    error = torch.tensor(0.0)
    for _ in range(cfg.steps):
        history, velocity, following = draw(data, cfg.batch)
        latent = latent_of(history)
        error = (estimator.velocity_head(latent) - velocity).square().mean()
        optimizer.zero_grad()
        (4.0 * error + him(latent, following)).backward()
        optimizer.step()
    history, _, following = draw(data, cfg.batch)
    with torch.no_grad():
        latent = latent_of(history)
        him(latent, following)
        source, target = normalize(him.source(latent)), normalize(him.target(following))
        own = (source @ target.T).argmax(-1) == torch.arange(cfg.batch)
    assert him.usage is not None
    return {
        "effective_rank": round(him.effective_rank().item(), 1),
        "prototypes_used": round(him.usage.item(), 1),
        "finds_its_partner": round(own.float().mean().item(), 3),
        "velocity_error_m_s": round(error.sqrt().item(), 3),
    }


def draw(data: tuple[Tensor, ...], count: int) -> tuple[Tensor, ...]:
    """Random rows."""
    index = torch.randint(len(data[0]), (count,))
    return tuple(column[index] for column in data)


if __name__ == "__main__":
    settings = tyro.cli(Cfg)
    recorded = record(settings)
    results = {
        f"temperature_{temperature:g}": learn(settings, recorded, temperature)
        for temperature in settings.temperatures
    }
    report({"histories": len(recorded[0]), **results}, settings.json)
