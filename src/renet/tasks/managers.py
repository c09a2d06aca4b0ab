"""mjlab's managers, all terms in one tensor: a step of few robots costs its number of operations.

Results are mjlab's. Terms that are functions in Warp (`terms.per_robot`) have been evaluated by one
kernel before (`judge.Judge`), others are by torch, one by one.
"""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
import warp as wp
from mjlab.managers.curriculum_manager import CurriculumManager
from mjlab.managers.metrics_manager import MetricsManager
from mjlab.managers.reward_manager import RewardManager
from mjlab.managers.termination_manager import TerminationManager
from torch import Tensor

from renet.tasks.terms import Launch, is_in_warp

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv


class StackedRewards(RewardManager):
    """Sums of weighted terms."""

    def __init__(self, cfg: dict, env: ManagerBasedRlEnv, *, scale_by_dt: bool = True) -> None:
        super().__init__(cfg, env, scale_by_dt=scale_by_dt)
        self.values = torch.zeros_like(self._step_reward)
        """Terms before their weights, [N, terms]; `judge.Judge` fills those written in Warp."""
        self._by_torch = _by_torch(self)
        self._sums = torch.zeros_like(self._step_reward)
        self._episode_sums = dict(zip(self._term_names, self._sums.unbind(-1), strict=True))
        self._weights = [0.0] * len(self._term_cfgs)
        self._weight = torch.zeros(len(self._term_cfgs), device=self.device)
        self._pay: dict[float, Launch] = {}

    def compute(self, dt: float) -> Tensor:
        """See RewardManager.compute."""
        weights = [term.weight for term in self._term_cfgs]
        if weights != self._weights:  # A curriculum may change them.
            self._weights = weights
            self._weight.copy_(torch.tensor(weights))
        for term in self._by_torch:
            if weights[term]:
                self.values[:, term] = _evaluate(self, term)
        scale = dt if self._scale_by_dt else 1.0
        if scale not in self._pay:
            inputs = [self.values, self._weight, scale, self._step_reward, self._sums]
            self._pay[scale] = Launch(pay, self.num_envs, [*inputs, self._reward_buf], self.device)
        self._pay[scale]()
        return self._reward_buf

    def reset(self, env_ids: Tensor | slice | None = None) -> dict[str, Tensor]:
        """See RewardManager.reset."""
        ids = slice(None) if env_ids is None else env_ids
        means = self._sums[ids].mean(0) / self._env.max_episode_length_s
        self._sums[ids] = 0.0
        _reset_terms(self, ids)
        return _named("Episode_Reward", self._term_names, means)


class StackedTerminations(TerminationManager):
    """Reasons to end an episode."""

    def __init__(self, cfg: dict, env: ManagerBasedRlEnv) -> None:
        super().__init__(cfg, env)
        device, terms = env.device, len(self._term_cfgs)
        time_out = torch.tensor(
            [term.time_out for term in self._term_cfgs], dtype=torch.bool, device=device
        )
        self.values = torch.zeros(env.num_envs, terms, dtype=torch.bool, device=device)
        """Terms, [N, terms]; `judge.Judge` fills those written in Warp."""
        self._by_torch = _by_torch(self)
        self._term_dones = dict(zip(self._term_names, self.values.unbind(-1), strict=True))
        self._done = torch.zeros_like(self._terminated_buf)
        results = [self._terminated_buf, self._truncated_buf, self._done]
        self._conclude = Launch(conclude, env.num_envs, [self.values, time_out, *results], device)

    def compute(self) -> Tensor:
        """See TerminationManager.compute."""
        for term in self._by_torch:
            self.values[:, term] = _evaluate(self, term)
        self._conclude()
        return self._done

    def reset(self, env_ids: Tensor | slice | None = None) -> dict[str, Tensor]:
        """See TerminationManager.reset; counts stay on the device."""
        ids = slice(None) if env_ids is None else env_ids
        _reset_terms(self, ids)
        return _named("Episode_Termination", self._term_names, self.values[ids].sum(0))


class StackedMetrics(MetricsManager):
    """Means over episodes."""

    def __init__(self, cfg: dict, env: ManagerBasedRlEnv) -> None:
        super().__init__(cfg, env)
        self._simple = all(term.reduce == "mean" and not term.per_substep for term in cfg.values())
        self.values = self._step_values
        """Terms, [N, terms]; `judge.Judge` fills those written in Warp."""
        self._by_torch = _by_torch(self)
        self._sums = torch.zeros_like(self._step_values)
        self._episode_sums = dict(zip(self._term_names, self._sums.unbind(-1), strict=True))
        inputs = [self.values, self._sums, self._step_count]
        self._tally = Launch(tally, env.num_envs, inputs, env.device)

    def compute(self) -> None:
        """See MetricsManager.compute."""
        if not self._simple:
            super().compute()
            return
        for term in self._by_torch:
            self.values[:, term] = self._compute_term(term)
        self._tally()

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


class DeviceCurriculum(CurriculumManager):
    """What it logs stays on the device."""

    def reset(self, env_ids: Tensor | slice | None = None) -> dict[str, Any]:
        """See CurriculumManager.reset."""
        logged = {}
        for name, state in self._curriculum_state.items():
            values = state if isinstance(state, dict) else {"": state}
            for kind, value in values.items():
                logged["/".join(filter(None, ("Curriculum", name, kind)))] = value
        _reset_terms(self, slice(None) if env_ids is None else env_ids)
        return logged


def _by_torch(manager: Any) -> list[int]:
    """Numbers of the terms that are not written in Warp."""
    return [i for i, term in enumerate(manager._term_cfgs) if not is_in_warp(term.func)]


def _evaluate(manager: Any, term: int) -> Tensor:
    """A term by torch, [N]."""
    cfg = manager._term_cfgs[term]
    value = cfg.func(manager._env, **cfg.params)
    manager._check_term_shape(manager._term_names[term], value)
    return value


def _reset_terms(manager: Any, ids: Tensor | slice) -> None:
    """Tell terms that remember something which robots begin anew."""
    for cfg in manager._class_term_cfgs:
        cfg.func.reset(env_ids=ids)


def _named(title: str, names: list[str], values: Tensor) -> dict[str, Tensor]:
    return {f"{title}/{name}": value for name, value in zip(names, values.unbind(), strict=True)}


@wp.kernel(enable_backward=False)
def conclude(
    ends: wp.array2d(dtype=wp.bool),
    time_out: wp.array(dtype=wp.bool),
    terminated: wp.array(dtype=wp.bool),
    truncated: wp.array(dtype=wp.bool),
    done: wp.array(dtype=wp.bool),
):
    """Tell failures from time-outs."""
    robot = wp.tid()
    failures, time_outs = wp.int32(0), wp.int32(0)
    for term in range(ends.shape[1]):
        if ends[robot, term]:
            if time_out[term]:
                time_outs += 1
            else:
                failures += 1
    terminated[robot] = failures > 0
    truncated[robot] = time_outs > 0
    done[robot] = failures + time_outs > 0


@wp.kernel(enable_backward=False)
def pay(
    values: wp.array2d(dtype=float),
    weights: wp.array(dtype=float),
    scale: float,
    rates: wp.array2d(dtype=float),
    sums: wp.array2d(dtype=float),
    rewards: wp.array(dtype=float),
):
    """Weigh the terms of rewards and add them up, over terms and over episodes.

    Broken physics gives NaN; its robot is reset, its reward must not spread.
    """
    robot = wp.tid()
    total = wp.float32(0.0)
    for term in range(values.shape[1]):
        rate = values[robot, term] * weights[term]
        if weights[term] == 0.0 or not wp.isfinite(rate):
            rate = 0.0
        rates[robot, term] = rate
        sums[robot, term] = sums[robot, term] + rate * scale
        total += rate * scale
    rewards[robot] = total


@wp.kernel(enable_backward=False)
def tally(
    values: wp.array2d(dtype=float),
    sums: wp.array2d(dtype=float),
    steps: wp.array(dtype=wp.int64),
):
    """Add metrics up over episodes."""
    robot = wp.tid()
    for term in range(values.shape[1]):
        sums[robot, term] = sums[robot, term] + values[robot, term]
    steps[robot] = steps[robot] + wp.int64(1)
