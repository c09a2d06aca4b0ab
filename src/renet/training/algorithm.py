"""RENet as an rsl_rl algorithm: estimators at 10 Hz, N-P3O at 50 Hz, one stage."""

from functools import partial
from typing import Any, Self

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor
from torch.optim import Optimizer

from renet.errors import RenetError
from renet.interface import CONSTRAINTS, STEPS_PER_TICK
from renet.models.adaptation import fuse, op_mask
from renet.models.config import ModelCfg
from renet.models.estimators import VPEstimator
from renet.models.expectation import mean_blocks
from renet.models.memory import EstimatorMemory
from renet.models.oracle import true_image
from renet.models.renet import RENet
from renet.models.symmetry import Mirror
from renet.sim.native.engine import NativeSimulation
from renet.sim.overflow import OverflowWatch
from renet.tasks.mdp.commands import COMMAND
from renet.training import distributed
from renet.training.average import WeightAverage
from renet.training.config import AdaptationCfg, NP3OCfg, SupervisionCfg, WithholdingCfg, from_dict
from renet.training.np3o import NP3O
from renet.training.precision import halve_threads, learning_type, side_by_side
from renet.training.storage import PolicyRollout, StepBuffer, TickRollout
from renet.training.supervision import Supervision
from renet.training.withholding import Withholding

CRITIC_GROUPS = ("proprioception_clean", "velocity", "feet_height", "height_map", "privileged")
"""Observation groups of the critics; the actor reads `proprioception` and the latent."""
NORMALIZER_ROWS = 65_536
"""Largest number of observations that the critics' normalizer learns from at once (80 MB)."""


def critic_observation(obs: TensorDict, *perception: Tensor) -> Tensor:
    """Concatenate the observation of the critics, [N, C].

    Args:
        obs: Observation groups by name.
        perception: Columns [N] about the policy's perception, such as the mask of OP.
    """
    groups = [obs[group] for group in CRITIC_GROUPS]
    columns = torch.stack(perception, dim=-1).to(groups[0].dtype)
    return torch.cat((*groups, columns), dim=-1)


def _overflow_watch(env: VecEnv) -> OverflowWatch | None:
    """Watch the buffers of MuJoCo Warp; those of C MuJoCo grow as needed."""
    simulation = getattr(env.unwrapped, "sim", None)
    if simulation is None or isinstance(simulation, NativeSimulation):
        return None
    return OverflowWatch(simulation)


class RenetAlgorithm:
    """Acting, recording and learning, with rsl_rl's algorithm interface."""

    def __init__(self, model: RENet, env: VecEnv, cfg: dict[str, Any], device: str) -> None:
        """Initialize the learners of a model (see `construct_algorithm`, which builds it).

        Args:
            model: All networks.
            env: Environments to learn in.
            cfg: The agent's configuration as a dictionary.
            device: Device to learn on.
        """
        self.device = device
        self.model = model.to(device)
        self.adaptation = from_dict(AdaptationCfg, cfg["adaptation"])
        dtype = learning_type(cfg["precision"], device)
        # rsl_rl adds two keys that N-P3O does not know.
        settings = dict(cfg["algorithm"])
        settings.pop("class_name", None)
        settings.pop("rnd_cfg", None)
        self.np3o = NP3O(model.actor, model.critics, from_dict(NP3OCfg, settings), dtype)
        self.supervision = Supervision(model, from_dict(SupervisionCfg, cfg["supervision"]), dtype)
        self.memory = EstimatorMemory(model.cfg, env.num_envs, device)
        # Both estimators also run on mirrored inputs, for the actor's mirror loss.
        self.mirror = Mirror(device)
        self.mirrored_memory: EstimatorMemory | None = None
        if self.np3o.cfg.mirror_loss > 0.0:
            self.mirrored_memory = EstimatorMemory(model.cfg, env.num_envs, device)
        withholding = from_dict(WithholdingCfg, cfg["withholding"])
        self.withholding = Withholding(withholding, env.num_envs, device)
        self.average = WeightAverage(self.model, cfg["average_over"])
        self.iteration = 0
        self.steps = 0
        """Environment steps taken, of all robots and processes."""
        self._steps = StepBuffer()
        self._ticks = StepBuffer()
        self._step_count = 0
        self._overflow = _overflow_watch(env)

    @classmethod
    def construct_algorithm(
        cls, obs: TensorDict, env: VecEnv, cfg: dict[str, Any], device: str
    ) -> Self:
        """Build model and algorithm from rsl_rl's dictionary.

        Raises:
            RenetError: The task lacks an observation group, its commands have no mirror image that
                the mirror loss could use, or the dictionary has an unknown key.
        """
        needed = (*CRITIC_GROUPS, *VPEstimator.quantities, "proprioception", "depth", "difficult")
        # Critics and estimators have groups in common, which are named once.
        groups = dict.fromkeys(needed)
        if missing := [group for group in groups if group not in obs]:
            raise RenetError(
                f"the task lacks the observation groups {', '.join(missing)}: RENet trains on "
                "tasks built like renet.tasks (Renet-Go1-Flat, Renet-Go1-Parkour)"
            )
        commands = getattr(env.unwrapped.cfg, "commands", {})
        told = getattr(commands.get(COMMAND), "told", None)
        if cfg["algorithm"]["mirror_loss"] and told == "heading":
            raise RenetError(
                "the mirror loss needs robots that are told twists, and those of this task are "
                f"told headings: add --env.commands.{COMMAND}.told twist, or leave it out"
            )
        # The mask of OP, and with withholding the age of the image (see `_perception`).
        columns = 2 if cfg["withholding"]["share"] else 1
        example = obs["difficult"][:, 0]
        critic_size = critic_observation(obs, *[example] * columns).shape[-1]
        model = RENet(from_dict(ModelCfg, cfg["model"]), critic_size)
        return cls(model, env, cfg, device)

    # Rollout.

    @torch.no_grad()
    def act(self, obs: TensorDict) -> Tensor:
        """Sample actions [N, 12], and advance the estimators at their ticks."""
        proprioception = obs["proprioception"]
        mask = self.op_mask(obs)
        self.memory.push(proprioception)
        if self.mirrored_memory is not None:
            self.mirrored_memory.push(self.mirror.proprioception(proprioception))
        if self._step_count % STEPS_PER_TICK == 0:
            self._tick(obs, mask)
        latent = fuse(self.memory.latent_op, self.memory.latent_vp, mask)
        distribution = self.model.actor.distribution(proprioception, latent)
        action = distribution.sample()
        self._steps.begin(
            proprioception=proprioception,
            latent=latent,
            mirrored_latent=self._mirrored_latent(mask),
            critic_observation=critic_observation(obs, *self._perception(mask)),
            action=action,
            mean=distribution.mean,
        )
        return action

    def _mirrored_latent(self, mask: Tensor) -> Tensor:
        """Return the latent that the actor would read in the mirror, [N, 128]; [N, 0] without."""
        memory = self.mirrored_memory
        if memory is None:
            return self.memory.latent_op[:, :0]
        return fuse(memory.latent_op, memory.latent_vp, mask)

    def op_mask(self, obs: TensorDict) -> Tensor:
        """Return a mask of the robots that OP steers in this iteration, [N] bool."""
        perception = self.model.cfg.perception
        return op_mask(perception, self.iteration, obs["difficult"], self.adaptation.period)

    def _perception(self, mask: Tensor) -> tuple[Tensor, ...]:
        """Return columns [N] for the critics: with withholding the image's age, and OP's mask."""
        if not self.withholding.cfg.share:
            return (mask,)
        return (self.memory.image_age, mask)

    def _tick(self, obs: TensorDict, mask: Tensor) -> None:
        """Advance the estimators, and record their inputs and targets."""
        memory = self.memory
        # The memory before the tick, from which learning replays it.
        fresh = memory.fresh.clone()
        latent_op = memory.latent_op
        latent_vp = memory.latent_vp

        has_image = self.withholding.tick(fresh, obs.get("easier"), self.steps)
        oracle = self.model.cfg.perception == "oracle"
        image = true_image(obs["height_map"]) if oracle else obs["depth"]
        blocks = self._blocks(image)
        last_blocks = self._blocks(memory.frames[:, 0])
        image_age = memory.image_age
        memory.see(image, has_image)
        memory.tick(self.model.advance)
        if self.mirrored_memory is not None:
            self.mirrored_memory.see(self.mirror.image(image), has_image)
            self.mirrored_memory.tick(self.model.advance)
        self._ticks.begin(
            history=memory.history,
            frames=memory.frames,
            has_image=memory.has_image,
            fresh=fresh,
            blocks=blocks,
            last_blocks=last_blocks,
            image_age=image_age,
            latent_op=latent_op,
            latent_vp=latent_vp,
            op_mask=mask,
            # Each head's target is the observation group of the same name.
            **{quantity: obs[quantity] for quantity in VPEstimator.quantities},
        )

    def _blocks(self, image: Tensor) -> Tensor:
        """Return the blocks of images [N, 48, 64], [N, 192]; [N, 0] without an expectation."""
        if self.model.expectation is None:
            return image.new_zeros(len(image), 0)
        image = image.float()
        if self.supervision.grass is not None:
            image = self.supervision.grass.before_robots(image)
        return mean_blocks(image).half()

    @torch.no_grad()
    def process_env_step(
        self, obs: TensorDict, rewards: Tensor, dones: Tensor, extras: dict[str, Any]
    ) -> None:
        """Record the results of an environment step.

        Args:
            obs: Observations after the step.
            rewards: Rewards, [N].
            dones: Not zero where the step ended its episode, [N].
            extras: `costs` of the constraints, [N, 3], and `time_outs`, [N].
        """
        done = dones.bool()
        self._steps.finish(
            rewards_and_costs=torch.cat((rewards.unsqueeze(-1), extras["costs"]), dim=-1),
            done=done,
            time_out=extras.get("time_outs", torch.zeros_like(done)),
        )
        if self._step_count % STEPS_PER_TICK == 0:
            self._ticks.finish(
                next_proprioception=obs["proprioception_clean"],
                next_velocity=obs["velocity"],
                next_valid=~done,
            )
        self.memory.reset(done)
        if self.mirrored_memory is not None:
            self.mirrored_memory.reset(done)
        self._step_count += 1
        if self._overflow is not None:
            self._overflow.look()

    # Learning.

    @torch.no_grad()
    def compute_returns(self, obs: TensorDict) -> None:
        """Compute values of all states of the rollout, and of the state after its last step."""
        steps = self._steps.stack()

        # Update the critics' normalizer, then normalize.
        normalize = self.model.critic_normalizer
        for rows in steps["critic_observation"].flatten(0, 1).split(NORMALIZER_ROWS):
            distributed.update_normalizer(normalize, rows)
        steps["critic_observation"] = normalize(steps["critic_observation"])

        # Values and log-probabilities of all states, in one batch each.
        steps["value"] = self.model.critics(steps["critic_observation"])
        last = critic_observation(obs, *self._perception(self.op_mask(obs)))
        self._last_value = self.model.critics(normalize(last))
        steps["log_prob"] = self.model.actor.log_prob(steps["mean"], steps["action"])

        # Logged costs are those of the environment, without the values added below.
        self._mean_costs = steps["rewards_and_costs"][..., 1:].mean((0, 1))

        # Bootstrap rewards and costs of episodes that a time-out cut short.
        time_out = steps.pop("time_out").unsqueeze(-1)
        steps["rewards_and_costs"] += self.np3o.cfg.gamma * steps["value"] * time_out
        self._rollout = PolicyRollout(**steps)

    def update(self) -> dict[str, float]:
        """Learn from the rollout; returns losses and mean costs by name."""
        tensors = self._learn(TickRollout(**self._ticks.stack()))
        # One transfer for all of them: it waits for a GPU.
        numbers = torch.stack(list(tensors.values())).tolist()
        losses = dict(zip(tensors, numbers, strict=True))

        self.average.update_parameters(self.model)
        for name, cost in zip(CONSTRAINTS, self._mean_costs.tolist(), strict=True):
            losses[f"cost_{name}"] = cost
        if self._overflow is not None:
            losses |= self._overflow.report()
        self.iteration += 1
        self.steps += self._rollout.done.numel() * distributed.world_size()
        return losses

    def _learn(self, ticks: TickRollout) -> dict[str, Tensor]:
        """Take an iteration's gradient steps; returns losses by name.

        Policy and estimators share no parameter: on a CPU they learn at the same time. Several
        ranks exchange gradients in an order that must be the same on all, so there they learn one
        after the other.
        """
        # Drawn before supervision draws its random numbers, so that a seed gives the same run.
        orders = self.np3o.draw_orders(self._rollout)
        update_policy = partial(
            self.np3o.update, self._rollout, self._last_value, orders, self.iteration, self.steps
        )
        update_estimators = partial(self.supervision.update, ticks, self.steps)
        if distributed.world_size() > 1:
            return update_policy() | update_estimators()
        with halve_threads(self.device):
            policy_losses, estimator_losses = side_by_side(update_policy, update_estimators)
        return policy_losses | estimator_losses

    def not_finite(self, obs: TensorDict) -> list[str]:
        """List the environment's outputs in the last rollout that hold NaN or infinity.

        Args:
            obs: Observations, for the sizes of their groups.
        """
        rollout = self._rollout
        sizes = [obs[group].shape[-1] for group in CRITIC_GROUPS]
        columns = rollout.critic_observation[..., : sum(sizes)].split(sizes, dim=-1)
        outputs = {"proprioception": rollout.proprioception}
        outputs |= dict(zip(CRITIC_GROUPS, columns, strict=True))
        names = [name for name, values in outputs.items() if not values.isfinite().all()]
        # Rewards and costs hold values of the critics, too, which observations may have spoilt.
        if not names and not rollout.rewards_and_costs.isfinite().all():
            return ["rewards or costs"]
        return names

    @property
    def optimizers(self) -> dict[str, Optimizer]:
        """Optimizers by their names in checkpoints."""
        return {"np3o": self.np3o.optimizer, "supervision": self.supervision.optimizer}

    @property
    def action_std(self) -> Tensor:
        """Standard deviation of each action, [12]."""
        return self.model.actor.log_std.detach().exp()
