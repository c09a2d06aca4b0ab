"""Robot Parkour Learning (Zhuang et al. 2023, arXiv 2309.05665) on RENet's robot and tiles.

A walking policy is specialised to each obstacle, first where obstacles give way and penetration is
penalised (soft dynamics), then where they do not (hard dynamics). One depth policy then imitates
all of them by DAgger, each on its own tiles; teachers drive at first, ever less often.
benchmarks/NOTES.md says what differs.
"""

import mujoco
import numpy as np
import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.reward_manager import RewardTermCfg
from torch import Tensor

from baselines.distillation import STUDENT, TEACHER, Stage
from renet.interface import LEGS
from renet.registry import register_task
from renet.tasks.env import RenetEnvCfg
from renet.tasks.mdp.base_state import on_tiles
from renet.tasks.parkour_env_cfg import parkour_env_cfg
from renet.tasks.sensors import FEET_HEIGHT
from renet.terrain.tiles import ACCENT, PIT
from renet.training.config import RenetRunnerCfg
from renet.training.recipe import recipe

SOFT = "Renet-Go1-Parkour-Soft"
"""The parkour task under soft dynamics."""
SOFT_SOLREF, SOFT_SOLIMP = (0.14, 1.0), (0.5, 0.5, 0.001, 0.5, 2.0)
"""MuJoCo's contact parameters of soft obstacles: a foot at rest sinks in by about 10 cm."""
SOFT_GAP = 0.1
"""Depth of a soft gap, m: a robot can walk through it."""


def soften(spec: mujoco.MjSpec) -> None:
    """Let platforms and blocks give way, and raise the floors of gaps; changes the scene."""
    for geom in spec.geoms:
        if np.allclose(geom.rgba, ACCENT):
            # Above that of the feet, whose parameters would else count.
            geom.priority, geom.condim = 2, 3
            geom.solref, geom.solimp = SOFT_SOLREF, SOFT_SOLIMP
        elif np.allclose(geom.rgba, PIT):
            geom.pos[2] = -SOFT_GAP - geom.size[2]


def penetration(env: ManagerBasedRlEnv) -> Tensor:
    """Depth of the feet in soft obstacles or below the edge of a gap, summed over feet, [N] m."""
    robot = env.scene["robot"]
    inside = torch.relu(-env.scene[FEET_HEIGHT].data)
    feet, _ = robot.find_sites(LEGS, preserve_order=True)
    height = env.sim.data.site_xpos[:, robot.indexing.site_ids[feet], 2]
    sunk = torch.relu(env.scene.env_origins[:, 2:] - height)
    return torch.where(on_tiles(env, "gap").unsqueeze(-1), sunk, inside).sum(-1)


def soft_env_cfg(play: bool = False) -> RenetEnvCfg:
    """Renet-Go1-Parkour-Soft."""
    cfg = parkour_env_cfg(play)
    cfg.scene.spec_fn = soften
    cfg.rewards["penetration"] = RewardTermCfg(func=penetration, weight=-2.0)
    return cfg


def register_soft() -> None:
    """Register that task, with the recipe's agent."""
    env, agent = soft_env_cfg(), RenetRunnerCfg()
    recipe(env, agent)
    register_task(SOFT, env, soft_env_cfg(play=True), agent)


register_soft()

SKILLS = {
    "run": ("rough", "obstacles", "stairs_up", "stairs_down"),
    "climb": ("platform",),
    "leap": ("gap",),
}
"""Kinds of tile on which each skill is learned and taught."""


def _specialise(skill: str) -> tuple[Stage, Stage]:
    """Both stages of a skill, from the walking policy on."""
    kinds = SKILLS[skill]
    soft = Stage(f"{skill}_soft", 1 / 12, TEACHER, task=SOFT, kinds=kinds, after="run")
    return soft, Stage(skill, 1 / 12, TEACHER, kinds=kinds, after=soft.name)


STAGES = (
    Stage("run", 1 / 3, TEACHER, kinds=SKILLS["run"]),
    *_specialise("climb"),
    *_specialise("leap"),
    Stage(
        "student", 1 / 3, STUDENT, teachers=SKILLS, distillation={"norm": 1, "teacher_drives": 60.0}
    ),
)
