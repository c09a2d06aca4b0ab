"""Configuration of the agent: networks, N-P3O, supervision, and settings of rsl_rl's runner."""

from dataclasses import dataclass, field
from math import ceil
from typing import Annotated, Any, Literal, TypeVar

import tyro
from mjlab.rl import RslRlBaseRunnerCfg

from renet.conversion import from_json
from renet.errors import RenetError
from renet.interface import STEPS_PER_TICK
from renet.models.config import ModelCfg
from renet.tasks.entity import ACTION_CLIP
from renet.tasks.schedule import Schedule, lowest, value_at
from renet.training.precision import Precision

_T = TypeVar("_T")
MOST_STEPS = 1000
"""Largest number of control steps of each robot in an iteration (20 s), unless
`num_steps_per_env` sets it."""


def _check_positive(cfg: Any, *names: str) -> None:
    """Raise RenetError unless the fields `names` of a configuration are at least 1."""
    for name in names:
        number = getattr(cfg, name)
        if number < 1:
            raise RenetError(f"{name.replace('_', '-')} must be at least 1, got {number}")


@dataclass
class NP3OCfg:
    """N-P3O (Lee et al. 2023): PPO on the reward, with penalties on constraint costs."""

    num_learning_epochs: int = 5
    """Passes over each rollout."""
    num_mini_batches: int = 4
    """Gradient steps per pass."""
    learning_rate: float = 1e-3
    """Initial learning rate of the actor, adapted to `desired_kl`."""
    critic_learning_rate: float = 3e-4
    """Learning rate of the critics. It is fixed: small batches drive the actor's to its smallest
    value, at which the critics could not follow the policy."""
    desired_kl: Schedule = 0.01
    """KL divergence per gradient step that the actor's learning rate is adapted to; 0 keeps the
    rate fixed."""
    gamma: float = 0.99
    """Discount per 20 ms control step."""
    lam: float = 0.95
    """Lambda of generalised advantage estimation."""
    clip: float = 0.2
    """Clipping range of the probability ratio and of values."""
    entropy: Schedule = 0.01
    """Weight of the entropy bonus."""
    max_std: Schedule | None = None
    """Largest standard deviation of actions, which each update keeps; None is no limit. With much
    noise a robot moves although its mean action stands, and nothing teaches the mean to start."""
    min_std: Schedule = 0.0
    """Smallest standard deviation of actions, which each update keeps; 0 is no limit. It lets a
    finished policy, whose noise is low, explore again, such as on another robot."""
    value_loss: float = 1.0
    """Weight of the critics' loss."""
    max_grad_norm: float = 1.0
    """Largest gradient norm. Actor and critics are clipped separately, so that noisy critics do not
    shorten the actor's step."""
    cost_budget: tuple[Schedule, Schedule, Schedule] = (0.0, 0.0, 0.0)
    """Budget d_i of each constraint's discounted cost, in the order of interface.CONSTRAINTS."""
    cost_weight: float = 0.1
    """Initial penalty kappa of every constraint; 0 is plain PPO."""
    cost_weight_growth: float = 1.0004
    """Growth g of the penalty: iteration i multiplies kappa by g^i, up to 1."""
    mirror_loss: float = 0.0
    """Weight of the mirror loss (Mittal et al. 2024, "Symmetry Considerations for Learning Task
    Symmetric Robot Policies"): the mean square of the difference between the mean action for a
    mirrored observation and the mirrored mean action. The command must be a twist. 0 is none."""

    def __post_init__(self) -> None:
        _check_positive(self, "num_learning_epochs", "num_mini_batches")
        for name in ("learning_rate", "critic_learning_rate"):
            # False for NaN, too.
            if not getattr(self, name) >= 0.0:
                raise RenetError(f"algorithm.{name} must be at least 0, got {getattr(self, name)}")
        for schedule in (self.desired_kl, self.entropy, *self.cost_budget):
            value_at(schedule, 0.0)
        if self.max_std is not None and not lowest(self.max_std) > 0.0:
            raise RenetError(f"algorithm.max_std must be above 0, got {self.max_std}")
        if not lowest(self.min_std) >= 0.0:
            raise RenetError(f"algorithm.min_std must be at least 0, got {self.min_std}")


@dataclass
class SupervisionCfg:
    """Supervised training of estimators and autoencoder beside the policy (paper, Method A)."""

    learning_rate: Schedule = 1e-3
    """Adam's learning rate (HIMLoco's)."""
    num_learning_epochs: int = 1
    """Passes over each rollout's ticks."""
    num_mini_batches: int = 4
    """Gradient steps per pass; each takes whole sequences of a share of the environments."""
    max_grad_norm: float = 10.0
    """Largest gradient norm (HIMLoco's)."""
    estimator_data: Literal["own", "all"] = "own"
    """Environments that train an estimator: those it steers (the paper's S_op and S_vp), or all."""
    velocity_scale: float = 2.0
    """Factor of velocities before their error is squared (Rudin et al. 2022 scale observations
    likewise)."""
    height_scale: float = 5.0
    """Factor of feet heights and height maps before their error is squared."""
    autoencoder_images: int = 128
    """Image pairs per gradient step of the autoencoder, drawn from the rollout."""

    def __post_init__(self) -> None:
        _check_positive(self, "num_learning_epochs", "num_mini_batches", "autoencoder_images")
        if lowest(self.learning_rate) < 0.0:
            raise RenetError(
                f"supervision.learning_rate must be at least 0, got {self.learning_rate}"
            )


@dataclass
class AdaptationCfg:
    """Online estimator adaptation (paper, Method A)."""

    period: int = 20
    """Iterations after which the estimators take turns on simple terrain."""

    def __post_init__(self) -> None:
        _check_positive(self, "period")


@dataclass
class WithholdingCfg:
    """Withholding of images from VP in training, so that it learns to walk on from memory."""

    share: float = 0.0
    """Share of the robots that lose images."""
    shortest: float = 0.3
    """Shortest time without images, s; times are drawn log-uniformly."""
    longest: float = 6.0
    """Longest time without images, s."""
    sight: float = 4.0
    """Mean time with images between two times without, s."""
    easier_shortest: Schedule = 0.3
    """`shortest` on tiles below the robot's level (see `TerrainLevels`), s."""
    easier_sight: Schedule = 4.0
    """`sight` on tiles below the robot's level, s."""

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
        if not min(lowest(self.easier_shortest), lowest(self.easier_sight)) > 0.0:
            raise RenetError("withholding.easier_shortest, withholding.easier_sight must exceed 0")


@dataclass(kw_only=True)
class RenetRunnerCfg(RslRlBaseRunnerCfg):
    """Configuration of learning, as mjlab's registry takes it.

    Defaults are the paper's, or where it gives none, those of the methods that it builds on.
    """

    model: ModelCfg = field(default_factory=ModelCfg)
    """Networks, and the paper's ablations."""
    algorithm: NP3OCfg = field(default_factory=NP3OCfg)
    """Policy optimisation."""
    supervision: SupervisionCfg = field(default_factory=SupervisionCfg)
    """Estimators and autoencoder."""
    adaptation: AdaptationCfg = field(default_factory=AdaptationCfg)
    """Choice of the estimator that steers."""
    withholding: WithholdingCfg = field(default_factory=WithholdingCfg)
    """Withholding of images from VP."""
    precision: Precision = "auto"
    """Type in which critics and depth embedding learn: bfloat16, float32, or auto (bfloat16 where
    the hardware multiplies it). All other layers compute in float32, on a GPU by TF32 unless this
    is float32; exported networks are float32."""
    seed: Annotated[int, tyro.conf.arg(aliases=["--seed"])] = 1
    """Seed of all random numbers."""
    batch_size: Schedule = 102_400
    """Smallest number of environment steps of a process in an iteration, over all its robots. Each
    robot takes at least 25 control steps and at most 1,000, a multiple of the 5 between ticks."""
    num_steps_per_env: int | None = None  # type: ignore[assignment]
    """Control steps of each robot per iteration, in place of the number that follows from
    `batch_size`; a multiple of the 5 between ticks."""
    max_iterations: Annotated[int, tyro.conf.arg(aliases=["--max-iterations"])] = 15_000
    """Iterations in all (the paper's budget, at 4,096 environments)."""
    average_over: int = 1
    """Iterations over which exported weights are averaged (an exponential moving average, which
    has less of the noise of single gradient steps); 1 exports the newest weights."""
    save_interval: int = 50
    """Iterations between checkpoints: the most that a killed run can lose."""
    keep_checkpoints: int = 3
    """Number of checkpoints to keep; older ones are removed."""
    clip_actions: float | None = ACTION_CLIP
    """Limit to which actions are clipped, in policy units."""
    logger: Literal["wandb", "tensorboard"] = "tensorboard"
    """Logger of the curves, beside `curves.csv`."""
    wandb_project: str = "renet"
    """Name of the wandb project."""
    upload_model: bool = False
    """Upload of checkpoints to wandb, which renet does not support."""
    load_checkpoint: str = "checkpoints"
    """Folder in which mjlab's own `train` finds a run's checkpoints; `renet train` has --resume."""
    task: tyro.conf.Fixed[str] = ""
    """Id of the registered task, which checkpoints state."""

    def __post_init__(self) -> None:
        _check_positive(self, "save_interval", "keep_checkpoints", "average_over")
        if self.clip_actions is not None and not self.clip_actions > 0.0:
            raise RenetError(f"clip-actions must be above 0, got {self.clip_actions}")
        # Raises if the schedule cannot be read.
        value_at(self.batch_size, 0.0)
        if self.num_steps_per_env is None:
            return
        _check_positive(self, "num_steps_per_env")
        if self.num_steps_per_env % STEPS_PER_TICK:
            raise RenetError(
                f"num-steps-per-env must be a multiple of {STEPS_PER_TICK} (10 Hz ticks of a 50 Hz "
                f"policy), got {self.num_steps_per_env}"
            )


def steps_per_env(fixed: int | None, batch_size: Schedule, num_envs: int, steps: float) -> int:
    """Return the number of control steps of each robot in an iteration.

    Args:
        fixed: Number in place of the one that follows from `batch_size`, or None.
        batch_size: Field of RenetRunnerCfg.
        num_envs: Robots of this process.
        steps: Environment steps taken before the iteration.
    """
    if fixed is not None:
        return fixed
    ticks = ceil(value_at(batch_size, steps) / num_envs / STEPS_PER_TICK)
    return min(STEPS_PER_TICK * max(5, ticks), MOST_STEPS)


def from_dict(cls: type[_T], values: dict[str, Any]) -> _T:
    """Build a part of the agent's configuration from a JSON object.

    Raises:
        RenetError: The object has another key than the fields, or a value of another type.
    """
    source = f"the settings of {cls.__name__}"
    remedy = "the configuration was written by another version of renet"
    return from_json(cls, values, source, remedy)
