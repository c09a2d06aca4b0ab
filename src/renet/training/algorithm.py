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
from renet.models.memory import EstimatorMemory
from renet.models.oracle import true_image
from renet.models.renet import RENet
from renet.sim.native.engine import NativeSimulation
from renet.sim.overflow import OverflowWatch
from renet.training import distributed
from renet.training.average import WeightAverage
from renet.training.config import AdaptationCfg, NP3OCfg, SupervisionCfg, WithholdingCfg, from_dict
from renet.training.np3o import NP3O
from renet.training.precision import halved_threads, learning_type, side_by_side
from renet.training.storage import PolicyRollout, Recorder, TickRollout
from renet.training.supervision import Supervision
from renet.training.withholding import Withholding

CRITIC_GROUPS = ("proprioception_clean", "velocity", "feet_height", "height_map", "privileged")
"""Observation groups the critics see; the actor sees `proprioception` and the latent."""
NORMALIZED_AT_ONCE = 65_536
"""Rows of a rollout from which the critics' normaliser learns at once (80 MB)."""


def critic_observation(obs: TensorDict, *perception: Tensor) -> Tensor:
    """What the critics see, [N, C]: CRITIC_GROUPS, and columns [N] on how the policy perceives."""
    groups = [obs[group] for group in CRITIC_GROUPS]
    return torch.cat((*groups, torch.stack(perception, dim=-1).to(groups[0].dtype)), dim=-1)


def _overflow_watch(env: VecEnv) -> OverflowWatch | None:
    """A watch on the engine's buffers; C MuJoCo's grow as they must."""
    simulation = getattr(env.unwrapped, "sim", None)
    warp = simulation is not None and not isinstance(simulation, NativeSimulation)
    return OverflowWatch(simulation) if warp else None


class RenetAlgorithm:
    """Acts, records and learns; the runner only loops (rsl_rl's algorithm interface)."""

    def __init__(self, model: RENet, env: VecEnv, cfg: dict[str, Any], device: str) -> None:
        """Set up for an environment; see `construct_algorithm`, which builds the model."""
        self.device = device
        self.model = model.to(device)
        self.adaptation = from_dict(AdaptationCfg, cfg["adaptation"])
        dtype = learning_type(cfg["precision"], device)
        np3o = {k: v for k, v in cfg["algorithm"].items() if k not in ("class_name", "rnd_cfg")}
        self.np3o = NP3O(model.actor, model.critics, from_dict(NP3OCfg, np3o), dtype)
        self.supervision = Supervision(model, from_dict(SupervisionCfg, cfg["supervision"]), dtype)
        self.memory = EstimatorMemory(model.cfg, env.num_envs, device)
        withholding = from_dict(WithholdingCfg, cfg["withholding"])
        self.withholding = Withholding(withholding, env.num_envs, device)
        self.average = WeightAverage(self.model, cfg["average_over"])
        self.iteration = 0
        self.steps = 0
        """Environment steps taken, of all robots and processes."""
        self._steps, self._ticks = Recorder(), Recorder()
        self._step_count = 0
        self._overflow = _overflow_watch(env)

    @classmethod
    def construct_algorithm(
        cls, obs: TensorDict, env: VecEnv, cfg: dict[str, Any], device: str
    ) -> Self:
        """Build from rsl_rl's dictionary configuration; raises RenetError on a foreign task."""
        groups = (*CRITIC_GROUPS, "far_map", "proprioception", "depth", "difficult")
        if missing := [group for group in groups if group not in obs]:
            raise RenetError(
                f"the task lacks the observation groups {', '.join(missing)}: RENet trains on "
                "tasks built like renet.tasks (Renet-Go1-Flat, Renet-Go1-Parkour)"
            )
        columns = 2 if cfg["withholding"]["share"] else 1
        critic_size = critic_observation(obs, *[obs["difficult"][:, 0]] * columns).shape[-1]
        return cls(RENet(from_dict(ModelCfg, cfg["model"]), critic_size), env, cfg, device)

    # Rollout.

    @torch.no_grad()
    def act(self, obs: TensorDict) -> Tensor:
        """Sample actions [N, 12]; ticks the estimators when they are due."""
        proprioception = obs["proprioception"]
        mask = self.op_mask(obs)
        self.memory.push(proprioception)
        if self._step_count % STEPS_PER_TICK == 0:
            self._tick(obs, mask)
        latent = fuse(self.memory.latent_op, self.memory.latent_vp, mask)
        distribution = self.model.actor.distribution(proprioception, latent)
        action, seen = distribution.sample(), self.critic_observation(obs, mask)
        row = {"proprioception": proprioception, "latent": latent, "critic_observation": seen}
        self._steps.begin(**row, action=action, mean=distribution.mean)
        return action

    def op_mask(self, obs: TensorDict) -> Tensor:
        """True where the OP estimator drives in this iteration, [N] bool."""
        perception, period = self.model.cfg.perception, self.adaptation.period
        return op_mask(perception, self.iteration, obs["difficult"], period)

    def critic_observation(self, obs: TensorDict, mask: Tensor) -> Tensor:
        """What the critics see of the present state, [N, C]."""
        age = [self.memory.image_age] if self.withholding.cfg.share else []
        return critic_observation(obs, *age, mask)

    def _tick(self, obs: TensorDict, mask: Tensor) -> None:
        """Advance the estimators and record what they are to be taught."""
        memory = self.memory
        fresh, latent_op, latent_vp = memory.fresh.clone(), memory.latent_op, memory.latent_vp
        sees = self.withholding.tick(fresh, obs.get("easier"), self.steps)
        oracle = self.model.cfg.perception == "oracle"
        memory.see(true_image(obs["height_map"]) if oracle else obs["depth"], sees)
        memory.tick(self.model.advance)
        self._ticks.begin(
            history=memory.history,
            frames=memory.frames,
            has_image=memory.has_image,
            fresh=fresh,
            latent_op=latent_op,
            latent_vp=latent_vp,
            op_mask=mask,
            velocity=obs["velocity"],
            feet_height=obs["feet_height"],
            height_map=obs["height_map"],
            far_map=obs["far_map"],
        )

    @torch.no_grad()
    def process_env_step(
        self, obs: TensorDict, rewards: Tensor, dones: Tensor, extras: dict[str, Any]
    ) -> None:
        """Record what the environment answered; `extras["costs"]` are [N, 3]."""
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
        self._step_count += 1
        if self._overflow is not None:
            self._overflow.look()

    # Learning.

    @torch.no_grad()
    def compute_returns(self, obs: TensorDict) -> None:
        """Value every state of the rollout in one batch, and the state after the last step."""
        steps = self._steps.stack()
        normalize = self.model.critic_normalizer
        for rows in steps["critic_observation"].flatten(0, 1).split(NORMALIZED_AT_ONCE):
            distributed.update_normalizer(normalize, rows)
        steps["critic_observation"] = normalize(steps["critic_observation"])
        steps["value"] = self.model.critics(steps["critic_observation"])
        last = self.critic_observation(obs, self.op_mask(obs))
        self._last_value = self.model.critics(normalize(last))
        self._mean_costs = steps["rewards_and_costs"][..., 1:].mean((0, 1))
        steps["log_prob"] = self.model.actor.log_prob(steps["mean"], steps["action"])
        # An episode cut short would have gone on: bootstrap rewards and costs alike.
        cut = steps.pop("time_out").unsqueeze(-1)
        steps["rewards_and_costs"] += self.np3o.cfg.gamma * steps["value"] * cut
        self._rollout = PolicyRollout(**steps)

    def update(self) -> dict[str, float]:
        """Learn from the rollout; returns losses and mean costs by name."""
        learned = self._learn(TickRollout(**self._ticks.stack()))
        numbers = torch.stack(list(learned.values())).tolist()  # At once: a GPU is waited for.
        losses = dict(zip(learned, numbers, strict=True))
        self.average.update_parameters(self.model)
        costs = zip(CONSTRAINTS, self._mean_costs.tolist(), strict=True)
        losses |= {f"cost_{name}": cost for name, cost in costs}
        if self._overflow is not None:
            losses |= self._overflow.report()
        self.iteration += 1
        self.steps += self._rollout.done.numel() * distributed.world_size()
        return losses

    def _learn(self, ticks: TickRollout) -> dict[str, Tensor]:
        """Take an iteration's gradient steps; returns losses by name.

        Policy and estimators share no parameter: on a CPU they learn at once. Several ranks send
        each other gradients in an order that must be the same on all, so there one after the other.
        """
        orders = self.np3o.draw_orders(self._rollout)  # Before supervision draws: seeds repeat.
        of_policy = partial(
            self.np3o.update, self._rollout, self._last_value, orders, self.iteration, self.steps
        )
        of_estimators = partial(self.supervision.update, ticks, self.steps)
        if distributed.world_size() > 1:
            return of_policy() | of_estimators()
        with halved_threads(self.device):
            policy, estimators = side_by_side(of_policy, of_estimators)
        return policy | estimators

    def not_finite(self, obs: TensorDict) -> list[str]:
        """Names of the environment's outputs in the last rollout that hold NaN or infinity."""
        rollout = self._rollout
        sizes = [obs[group].shape[-1] for group in CRITIC_GROUPS]
        columns = rollout.critic_observation[..., : sum(sizes)].split(sizes, dim=-1)
        names = ("proprioception", *CRITIC_GROUPS)
        values = (rollout.proprioception, *columns)
        broken = [n for n, v in zip(names, values, strict=True) if not v.isfinite().all()]
        if not broken and not rollout.rewards_and_costs.isfinite().all():
            return ["rewards or costs"]  # Which hold critics' values, too.
        return broken

    @property
    def optimizers(self) -> dict[str, Optimizer]:
        """By the names that checkpoints give them."""
        return {"np3o": self.np3o.optimizer, "supervision": self.supervision.optimizer}

    @property
    def action_std(self) -> Tensor:
        """Deviation of each action, [12]."""
        return self.model.actor.log_std.detach().exp()
