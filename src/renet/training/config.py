"""The agent's configuration: networks, N-P3O, supervision, and what rsl_rl's runner reads."""

from dataclasses import dataclass, field, fields
from math import ceil
from typing import Annotated, Any, Literal, TypeVar

import tyro
from mjlab.rl import RslRlBaseRunnerCfg

from renet.errors import RenetError
from renet.interface import STEPS_PER_TICK
from renet.models.config import ModelCfg
from renet.tasks.robot_cfg import ACTION_CLIP
from renet.tasks.schedule import Schedule, value_at
from renet.training.precision import Precision

T = TypeVar("T")
MOST_STEPS = 1000
"""Control steps of each robot in an iteration, at most, unless their number is set: 20 s."""


def _at_least_one(cfg: Any, *names: str) -> None:
    for name in names:
        number = getattr(cfg, name)
        if number < 1:
            raise RenetError(f"{name.replace('_', '-')} must be at least 1, got {number}")


@dataclass
class NP3OCfg:
    """N-P3O (Lee et al. 2023): PPO on the reward plus penalised constraint costs."""

    num_learning_epochs: int = 5
    """Passes over each rollout."""
    num_mini_batches: int = 4
    """Gradient steps per pass."""
    learning_rate: float = 1e-3
    """The actor's initial rate; adapted to `desired_kl`."""
    critic_learning_rate: float = 3e-4
    """The critics' rate, fixed: small batches drive the actor's to its floor, where critics would
    no longer follow the policy."""
    desired_kl: Schedule = 0.01
    """KL divergence per step the rate is adapted to; 0 keeps the rate fixed."""
    gamma: float = 0.99
    """Discount per 20 ms control step."""
    lam: float = 0.95
    """Lambda of generalised advantage estimation."""
    clip: float = 0.2
    """Clipping range of ratio and value."""
    entropy: Schedule = 0.01
    """Weight of the entropy bonus."""
    value_loss: float = 1.0
    """Weight of the critics' loss."""
    max_grad_norm: float = 1.0
    """Gradient norm limit of the actor, and of the critics: each is clipped on its own, so that
    noisy critics do not shorten the actor's step."""
    cost_budget: tuple[Schedule, Schedule, Schedule] = (0.0, 0.0, 0.0)
    """Allowed discounted cost d_i per constraint, order of interface.CONSTRAINTS."""
    cost_weight: float = 0.1
    """Initial penalty kappa of every constraint; 0 is plain PPO."""
    cost_weight_growth: float = 1.0004
    """kappa is multiplied by this to the power of the iteration, each iteration, up to 1."""

    def __post_init__(self) -> None:
        _at_least_one(self, "num_learning_epochs", "num_mini_batches")
        for schedule in (self.desired_kl, self.entropy, *self.cost_budget):
            value_at(schedule, 0.0)


@dataclass
class SupervisionCfg:
    """Supervised training of estimators and autoencoder beside the policy (paper, Method A)."""

    learning_rate: Schedule = 1e-3
    """Adam's rate (HIMLoco's)."""
    num_learning_epochs: int = 1
    """Passes over each rollout's ticks."""
    num_mini_batches: int = 4
    """Gradient steps per pass; each takes whole sequences of a share of the environments."""
    max_grad_norm: float = 10.0
    """Gradient norm limit (HIMLoco's)."""
    estimator_data: Literal["own", "all"] = "own"
    """Which environments train an estimator: those it steers (the paper's S_op and S_vp) or all."""
    velocity_scale: float = 2.0
    """Velocities are multiplied by this before their error is squared (Rudin et al. 2022 scale
    observations so)."""
    height_scale: float = 5.0
    """The same for feet heights and height maps."""
    autoencoder_images: int = 128
    """Image pairs per gradient step of the autoencoder, drawn from the rollout."""

    def __post_init__(self) -> None:
        _at_least_one(self, "num_learning_epochs", "num_mini_batches", "autoencoder_images")
        value_at(self.learning_rate, 0.0)


@dataclass
class AdaptationCfg:
    """Online estimator adaptation (paper, Method A)."""

    period: int = 20
    """Iterations before simple terrain changes its estimator."""

    def __post_init__(self) -> None:
        _at_least_one(self, "period")


@dataclass
class WithholdingCfg:
    """Images withheld from VP in training, so that it learns to walk on from memory."""

    share: float = 0.0
    """Share of the robots that lose images; the others always see."""
    shortest: float = 0.3
    """Shortest time without an image, s; times are drawn log-uniformly."""
    longest: float = 6.0
    """Longest time without an image, s."""
    sight: float = 4.0
    """Mean time with images in between, s."""
    easier_shortest: Schedule = 0.3
    """`shortest` on tiles easier than the robot's level (`TerrainLevels`)."""
    easier_sight: Schedule = 4.0
    """`sight` there."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise RenetError(f"withholding.share must be from 0 to 1, got {self.share}")
        if not 0.0 < self.shortest <= self.longest:
            raise RenetError(
                f"withholding.shortest must be above 0 and at most withholding.longest, got "
                f"{self.shortest} and {self.longest} s"
            )
        if not self.sight > 0.0:
            raise RenetError(f"withholding.sight must be above 0 s, got {self.sight}")
        if not min(value_at(self.easier_shortest, 0.0), value_at(self.easier_sight, 0.0)) > 0.0:
            raise RenetError("withholding.easier_shortest, withholding.easier_sight must exceed 0")


@dataclass(kw_only=True)
class RenetRunnerCfg(RslRlBaseRunnerCfg):
    """Everything about learning, as mjlab's registry takes it; the defaults are the paper's, or
    where it is silent those of the methods it builds on."""

    model: ModelCfg = field(default_factory=ModelCfg)
    """Networks and the paper's ablations."""
    algorithm: NP3OCfg = field(default_factory=NP3OCfg)
    """Policy optimisation."""
    supervision: SupervisionCfg = field(default_factory=SupervisionCfg)
    """Estimators and autoencoder."""
    adaptation: AdaptationCfg = field(default_factory=AdaptationCfg)
    """Which estimator steers where."""
    withholding: WithholdingCfg = field(default_factory=WithholdingCfg)
    """Images that VP does without."""
    precision: Precision = "auto"
    """What critics and depth embedding learn in: bfloat16, float32, or auto (bfloat16 where the
    machine multiplies it). All else is float32 (on a GPU by TF32 unless float32 is asked for), and
    so is what is exported."""
    seed: Annotated[int, tyro.conf.arg(aliases=["--seed"])] = 1
    """Seed of everything random."""
    batch_size: Schedule = 102_400
    """Environment steps of all robots of a process in an iteration, at least: 25 control steps of
    each, or as many more as fewer robots need (rounded up to a multiple of the 5 between ticks),
    1,000 at most."""
    num_steps_per_env: int | None = None  # type: ignore[assignment]
    """Control steps per iteration in place of those that follow from `batch_size`; a multiple of
    the 5 steps between ticks."""
    max_iterations: Annotated[int, tyro.conf.arg(aliases=["--max-iterations"])] = 15_000
    """Iterations in all (the paper's budget, at 4,096 environments)."""
    average_over: int = 1
    """Iterations over which the weights that are exported are averaged (an exponential moving
    average: each gradient step leaves noise of its own, which their mean has less of); 1 exports
    the newest weights."""
    save_interval: int = 50
    """Iterations between checkpoints: the most a killed run can lose."""
    keep_checkpoints: int = 3
    """Checkpoints that are kept; older ones are removed."""
    clip_actions: float | None = ACTION_CLIP
    """Policy units beyond which actions are cut."""
    logger: Literal["wandb", "tensorboard"] = "tensorboard"
    """Where curves go beside `curves.csv`."""
    wandb_project: str = "renet"
    """The wandb project name."""
    upload_model: bool = False
    """Checkpoints stay on the disk."""
    load_checkpoint: str = "checkpoints"
    """Where mjlab's own `train` finds a run's checkpoints; `renet train` takes --resume."""
    task: tyro.conf.Fixed[str] = ""
    """Id under which the task is registered, which a checkpoint keeps."""

    def __post_init__(self) -> None:
        _at_least_one(self, "save_interval", "keep_checkpoints", "average_over")
        value_at(self.batch_size, 0.0)
        if self.num_steps_per_env is None:
            return
        _at_least_one(self, "num_steps_per_env")
        if self.num_steps_per_env % STEPS_PER_TICK:
            raise RenetError(
                f"num-steps-per-env must be a multiple of {STEPS_PER_TICK} (10 Hz ticks of a 50 Hz "
                f"policy), got {self.num_steps_per_env}"
            )


def steps_per_env(fixed: int | None, batch_size: Schedule, num_envs: int, steps: float) -> int:
    """Control steps of each robot in the iteration that begins after `steps` environment steps.

    Args:
        fixed: number in place of the one that follows from `batch_size`, or None.
        batch_size: of RenetRunnerCfg. num_envs: robots of this process.
        steps: environment steps taken so far.
    """
    if fixed is not None:
        return fixed
    ticks = ceil(value_at(batch_size, steps) / num_envs / STEPS_PER_TICK)
    return min(STEPS_PER_TICK * max(5, ticks), MOST_STEPS)


def from_dict(cls: type[T], values: dict[str, Any]) -> T:
    """Build a dataclass from JSON, lists as tuples; raises RenetError for an unknown key."""
    unknown = sorted(set(values) - {f.name for f in fields(cls)})  # type: ignore[arg-type]
    if unknown:
        raise RenetError(
            f"{cls.__name__} has no field {', '.join(unknown)}: the configuration was written by "
            "another version of renet"
        )
    return cls(**{name: to_tuples(value) for name, value in values.items()})


def to_tuples(value: Any) -> Any:
    """A value of JSON with tuples in place of lists, also of nested ones."""
    return tuple(map(to_tuples, value)) if isinstance(value, list) else value
