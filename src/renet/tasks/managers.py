"""mjlab's managers, all terms in one tensor: a step of few robots costs its number of operations.

Results are mjlab's; a term of one of them is added up with the others instead of on its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from mjlab.managers.metrics_manager import MetricsManager
from mjlab.managers.reward_manager import RewardManager
from mjlab.managers.termination_manager import TerminationManager
from torch import Tensor

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv


class StackedRewards(RewardManager):
    """Rewards, and each term as it was before its weight."""

    def __init__(self, cfg: dict, env: ManagerBasedRlEnv, *, scale_by_dt: bool = True) -> None:
        super().__init__(cfg, env, scale_by_dt=scale_by_dt)
        self._sums = torch.zeros_like(self._step_reward)
        self._episode_sums = dict(zip(self._term_names, self._sums.unbind(-1), strict=True))
        self._none = torch.zeros(env.num_envs, device=env.device)
        self._values = list(self._step_reward.unbind(-1))
        self._weights: list[float] = []

    def compute(self, dt: float) -> Tensor:
        """See RewardManager.compute."""
        weights = [term.weight for term in self._term_cfgs]
        if weights != self._weights:  # A curriculum may change them.
            self._weights, self._weight = weights, torch.tensor(weights, device=self.device)
        self._values = [
            self._evaluate(term) if weight else self._none for term, weight in enumerate(weights)
        ]
        rates = torch.stack(self._values, dim=-1) * self._weight
        # Broken physics gives NaN; its robot is reset, its reward must not spread.
        self._step_reward = rates.nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)
        rewards = self._step_reward * (dt if self._scale_by_dt else 1.0)
        self._sums += rewards
        self._reward_buf = rewards.sum(-1)
        return self._reward_buf

    def reset(self, env_ids: Tensor | slice | None = None) -> dict[str, Tensor]:
        """See RewardManager.reset."""
        ids = slice(None) if env_ids is None else env_ids
        means = self._sums[ids].mean(0) / self._env.max_episode_length_s
        self._sums[ids] = 0.0
        _reset_terms(self, ids)
        return _named("Episode_Reward", self._term_names, means)

    def value(self, name: str) -> Tensor:
        """A term in the step just rewarded, before its weight, [N]."""
        term = self._term_names.index(name)
        return self._values[term] if self._weights[term] else self._evaluate(term)

    def _evaluate(self, term: int) -> Tensor:
        cfg = self._term_cfgs[term]
        value = cfg.func(self._env, **cfg.params)
        self._check_term_shape(self._term_names[term], value)
        return value


class StackedTerminations(TerminationManager):
    """Reasons to end an episode."""

    def __init__(self, cfg: dict, env: ManagerBasedRlEnv) -> None:
        super().__init__(cfg, env)
        time_outs = [term.time_out for term in self._term_cfgs]
        self._time_out = torch.tensor(time_outs, device=env.device)
        self._dones = torch.zeros(env.num_envs, len(time_outs), dtype=torch.bool, device=env.device)

    def compute(self) -> Tensor:
        """See TerminationManager.compute."""
        values = []
        for name, cfg in zip(self._term_names, self._term_cfgs, strict=True):
            values.append(cfg.func(self._env, **cfg.params))
            self._check_term_shape(name, values[-1])
        self._term_dones = dict(zip(self._term_names, values, strict=True))
        self._dones = torch.stack(values, dim=-1)
        self._truncated_buf = (self._dones & self._time_out).any(-1)
        self._terminated_buf = (self._dones & ~self._time_out).any(-1)
        return self._truncated_buf | self._terminated_buf

    def reset(self, env_ids: Tensor | slice | None = None) -> dict[str, Tensor]:
        """See TerminationManager.reset; counts stay on the device."""
        ids = slice(None) if env_ids is None else env_ids
        _reset_terms(self, ids)
        return _named("Episode_Termination", self._term_names, self._dones[ids].sum(0))


class StackedMetrics(MetricsManager):
    """Means over episodes."""

    def __init__(self, cfg: dict, env: ManagerBasedRlEnv) -> None:
        super().__init__(cfg, env)
        self._simple = all(term.reduce == "mean" and not term.per_substep for term in cfg.values())
        self._sums = torch.zeros_like(self._step_values)
        self._episode_sums = dict(zip(self._term_names, self._sums.unbind(-1), strict=True))

    def compute(self) -> None:
        """See MetricsManager.compute."""
        if not self._simple:
            super().compute()
            return
        self._step_count += 1
        values = [self._compute_term(term) for term in self._step_term_indices]
        self._step_values = torch.stack(values, dim=-1)
        self._sums += self._step_values

    def reset(self, env_ids: Tensor | slice | None = None) -> dict[str, Tensor]:
        """See MetricsManager.reset."""
        if not self._simple:
            return super().reset(env_ids)
        ids = slice(None) if env_ids is None else env_ids
        steps = self._step_count[ids].clamp_min(1).unsqueeze(-1)
        means = (self._sums[ids] / steps).mean(0)
        self._sums[ids], self._step_count[ids] = 0.0, 0
        _reset_terms(self, ids)
        return _named("Episode_Metrics", self._term_names, means)


def _reset_terms(manager: Any, ids: Tensor | slice) -> None:
    """Tell terms that remember something which robots begin anew."""
    for cfg in manager._class_term_cfgs:
        cfg.func.reset(env_ids=ids)


def _named(title: str, names: list[str], values: Tensor) -> dict[str, Tensor]:
    return {f"{title}/{name}": value for name, value in zip(names, values.unbind(), strict=True)}
