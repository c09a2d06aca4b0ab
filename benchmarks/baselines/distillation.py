"""Methods of two stages: privileged teachers learn by reinforcement, a depth policy imitates them.

The student is RENet's VP estimator and actor under another loss, and teachers are its Oracle, so
that methods differ in how they learn and not in their networks. rsl_rl's `Distillation` is not
used: it has one teacher, keeps an image for every control step, where the camera brings one in
five, and cannot go on from our checkpoints.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from baselines.checkpoint_policy import RecurrentPolicy
from renet.errors import RenetError
from renet.models.renet import RENet
from renet.registry import register_task
from renet.tasks.parkour_env_cfg import parkour_env_cfg
from renet.training import checkpoint as checkpoints
from renet.training.algorithm import RenetAlgorithm
from renet.training.config import RenetRunnerCfg, SupervisionCfg, from_dict
from renet.training.export import load_networks
from renet.training.precision import halve_threads
from renet.training.recipe import recipe
from renet.training.runner import RenetRunner
from renet.training.storage import StepBuffer, TickRollout
from renet.training.supervision import MiniBatch, Supervision

TASK, STUDENT_TASK = "Renet-Go1-Parkour", "Renet-Go1-Parkour-Student"
TEACHER = {"perception": "oracle"}
"""Fields of ModelCfg for a policy that sees the true height map."""
STUDENT = {
    "perception": "vp",
    "predict_velocity": False,
    "predict_feet_height": False,
    "predict_height_map": False,
    "him": False,
}
"""The same for one that reads depth and is taught actions alone."""


@dataclass
class DistillationCfg:
    """The student's teachers, and how it learns from them."""

    teachers: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """Checkpoint of each teacher, and the kinds of tile on which it teaches; none: on all."""
    norm: int = 2
    """The loss is the mean of this norm of the difference of actions: 1 or 2."""
    starts_as_teacher: bool = False
    """Whether the student's actor begins with the first teacher's weights."""
    teacher_drives: float = 0.0
    """Iterations in which the probability that an episode is driven by a teacher falls by a factor
    of e, from 1; 0: the student always drives."""


@dataclass(frozen=True)
class Stage:
    """One training run of a method, of those it takes."""

    name: str
    share: float
    """Share of the method's environment steps."""
    model: Mapping[str, Any] = field(default_factory=dict)
    """Fields of ModelCfg that differ from the recipe's."""
    task: str = TASK
    """Where it learns."""
    kinds: tuple[str, ...] = ()
    """Kinds of tile on which nearly all robots practise; none: as in the recipe."""
    after: str | None = None
    """Stage whose last checkpoint it goes on from."""
    teachers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Stages that teach it, and on which kinds of tile; none: it learns by reinforcement."""
    distillation: Mapping[str, Any] = field(default_factory=dict)
    """Other fields of DistillationCfg."""


@dataclass
class DistillationRollout(TickRollout):
    """What the student saw, and what its teachers would have done; T control steps."""

    proprioception: Tensor
    """o_t, noisy, [T, N, 45]."""
    expert: Tensor
    """The teacher's mean action, [T, N, 12]."""
    blank: Tensor
    """No tick since the episode began, [T, N] bool: the actor read zeros for a latent."""


class Imitation(Supervision):
    """Trains the student's estimator and actor as one network; the detector learns as always."""

    def __init__(
        self, model: RENet, cfg: SupervisionCfg, norm: int, dtype: torch.dtype = torch.float32
    ) -> None:
        """Set up for a model that is where it is to stay; `norm` is DistillationCfg's."""
        super().__init__(model, cfg, dtype)
        self._norm = norm
        self.parameters = [*model.actor.mean.parameters(), *self.parameters]
        rate = self.optimizer.param_groups[0]["lr"]
        self.optimizer = torch.optim.Adam(self.parameters, lr=rate, fused=True)

    def _vp_losses(self, rollout: TickRollout, batch: MiniBatch) -> dict[str, Tensor]:
        assert isinstance(rollout, DistillationRollout)
        rollout = rollout.environments(batch.index)
        latent = self.model.vp.unroll(
            rollout.history,
            rollout.frames.float(),
            rollout.has_image,
            rollout.latent_vp[0],
            rollout.fresh,
        )
        latent = latent.repeat_interleave(len(rollout.blank) // len(latent), dim=0)
        latent = latent * ~rollout.blank.unsqueeze(-1)
        # OP's half is zero wherever VP steers (eq. 3).
        read = torch.cat((torch.zeros_like(latent), latent), dim=-1)
        error = self.model.actor(rollout.proprioception, read) - rollout.expert
        return {"imitation": error.norm(p=self._norm, dim=-1).mean()}


class DistillationAlgorithm(RenetAlgorithm):
    """DAgger (Ross et al. 2011): the student drives, teachers say what they would have done."""

    distillation: DistillationCfg

    @classmethod
    def construct_algorithm(
        cls, obs: TensorDict, env: VecEnv, cfg: dict[str, Any], device: str
    ) -> Self:
        """Build from rsl_rl's dictionary, with `distillation` in it; raises RenetError."""
        made = super().construct_algorithm(obs, env, cfg, device)
        supervision = made.supervision
        made.distillation = from_dict(DistillationCfg, cfg["distillation"])
        made.supervision = Imitation(
            made.model, supervision.cfg, made.distillation.norm, supervision.dtype
        )
        made._load_teachers(env.unwrapped.scene.terrain)  # type: ignore[attr-defined]
        return made

    def _load_teachers(self, terrain: Any) -> None:
        """Load teachers and divide the robots among them, by the tiles these are on.

        Raises:
            RenetError: a checkpoint that is none of a teacher, or a robot without one.
        """
        cfg = self.distillation
        names, kinds = list(terrain.cfg.terrain_generator.sub_terrains), terrain.terrain_types
        self._teachers: list[tuple[RecurrentPolicy, Tensor]] = []
        reached: list[dict[str, Tensor]] = []
        taught = torch.zeros_like(kinds, dtype=torch.bool)
        for path, lessons in cfg.teachers:
            checkpoint = checkpoints.load_checkpoint(Path(path), self.device)
            model = load_networks(Path(path)).to(self.device)
            if model.cfg.perception != "oracle":
                raise RenetError(f"{path} cannot teach: it is not a policy with perception oracle")
            kind_ids = torch.tensor(
                [names.index(name) for name in lessons or names], device=kinds.device
            )
            robots = torch.isin(kinds, kind_ids)
            taught |= robots
            pupils = robots.nonzero().squeeze(-1)
            self._teachers.append((RecurrentPolicy(model, len(pupils), self.device), pupils))
            state = checkpoint.environment
            its = torch.isin(state["kinds"], kind_ids.to(state["kinds"].device))
            reached.append({name: state[name][its] for name in ("levels", "passed", "kinds")})
        if not taught.all():
            raise RenetError(f"nobody teaches on {names[int(kinds[~taught][0])]}")
        self.reached = checkpoint.environment | {
            name: torch.cat([environment[name] for environment in reached]) for name in reached[0]
        }
        """Curriculum of the teachers, from which the student goes on."""
        if cfg.starts_as_teacher:
            self.model.actor.load_state_dict(self._teachers[0][0].model.actor.state_dict())
        self._lessons = StepBuffer()
        self._driven = torch.full_like(taught, cfg.teacher_drives > 0)

    def expert(self, obs: TensorDict) -> Tensor:
        """Mean actions of each robot's teacher, [N, 12]; called once in a control step."""
        groups = [obs[name] for name in ("proprioception", "depth", "height_map")]
        action = torch.empty(len(groups[0]), len(self.action_std), device=self.device)
        for teacher, robots in self._teachers:
            sees = torch.zeros_like(robots, dtype=torch.bool)
            action[robots] = teacher.step(*(group[robots] for group in groups), sees)
        return action

    @torch.no_grad()
    def act(self, obs: TensorDict) -> Tensor:
        """Mean actions [N, 12] of the student, or of teachers where these drive."""
        super().act(obs)
        row, expert = self._steps.newest, self.expert(obs)
        self._lessons.begin(
            proprioception=row["proprioception"], expert=expert, blank=self.memory.fresh
        )
        return torch.where(self._driven.unsqueeze(-1), expert, row["mean"])

    def process_env_step(
        self, obs: TensorDict, rewards: Tensor, dones: Tensor, extras: dict[str, Any]
    ) -> None:
        """Record what the environment answered; draw who drives the episodes that begin."""
        super().process_env_step(obs, rewards, dones, extras)
        for teacher, robots in self._teachers:
            teacher.memory.reset(dones[robots].bool())
        over = self.distillation.teacher_drives
        share = math.exp(-self.iteration / over) if over else 0.0
        drawn = torch.rand(len(dones), device=self._driven.device) < share
        self._driven = torch.where(dones.bool(), drawn, self._driven)

    def _learn(self, ticks: TickRollout) -> dict[str, Tensor]:
        """Imitate, in place of reinforcement."""
        rollout = DistillationRollout(**vars(ticks), **self._lessons.stack())
        with halve_threads(self.device):
            return self.supervision.update(rollout, self.steps)


class DistillationRunner(RenetRunner):
    """RENet's runner of a student, which begins on the levels that its teachers reached."""

    alg: DistillationAlgorithm  # type: ignore[assignment]
    algorithm = "baselines.distillation:DistillationAlgorithm"

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.restore_curriculum(self.alg.reached)


@dataclass(kw_only=True)
class StudentCfg(RenetRunnerCfg):
    """The agent's configuration of a student."""

    distillation: DistillationCfg = field(default_factory=DistillationCfg)
    """Its teachers, and how it learns from them."""


def register_student() -> None:
    """Register the task in which students learn."""
    env, agent = parkour_env_cfg(), StudentCfg()
    recipe(env, agent)
    register_task(STUDENT_TASK, env, parkour_env_cfg(play=True), agent, DistillationRunner)


register_student()
