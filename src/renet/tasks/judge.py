"""One kernel that judges a control step: costs, reasons to end, rewards and metrics."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import warp as wp
from torch import Tensor

from renet.tasks.constraints import constraint_costs
from renet.tasks.step import Step
from renet.tasks.terms import Columns, Launch, is_in_warp

if TYPE_CHECKING:
    from renet.tasks.env import RenetEnv


class Judge:
    """Fills the tables of those of the managers' terms that are written in Warp, and costs."""

    def __init__(self, env: RenetEnv) -> None:
        """Watch an environment whose managers are loaded."""
        managers = (env.termination_manager, env.reward_manager, env.metrics_manager)
        self._tables = [manager.values for manager in managers]
        self._terms = [[term.func for term in manager._term_cfgs] for manager in managers]
        columns = (
            tuple((i, term.compiled) for i, term in enumerate(terms) if is_in_warp(term))
            for terms in self._terms
        )
        inputs = [env.watched, *self._tables]
        self._launch = Launch(judging(*columns), env.num_envs, inputs, env.device)
        self._begun = wp.to_torch(env.watched.begun)
        self.costs = wp.to_torch(env.watched.costs)
        """Of the last step times its dt, order of vocabulary.CONSTRAINTS, [N, 3]."""

    def __call__(self) -> None:
        """Judge the step that the simulation has just taken, once."""
        self._launch()

    def forget(self, env_ids: Tensor) -> None:
        """These robots begin a new episode."""
        self._begun[env_ids] = False

    def value(self, function: Callable) -> Tensor:
        """What a term made of the last step, [N]; raises ValueError where the task has no such."""
        for table, terms in zip(self._tables, self._terms, strict=True):
            if function in terms:
                return table[:, terms.index(function)]
        raise ValueError(f"the task has no term {function.__name__}")


@lru_cache(maxsize=32)
def judging(ends: Columns, rewards: Columns, metrics: Columns) -> Any:
    """The kernel for a task's terms."""

    @wp.kernel(module="unique", enable_backward=False)
    def judge(
        step: Step,  # type: ignore[valid-type]
        end: wp.array2d(dtype=wp.bool),  # type: ignore[valid-type]
        reward: wp.array2d(dtype=float),  # type: ignore[valid-type]
        metric: wp.array2d(dtype=float),  # type: ignore[valid-type]
    ):
        robot = wp.tid()
        cost = constraint_costs(step, robot)
        for i in range(3):
            step.costs[robot, i] = wp.where(wp.isfinite(cost[i]), cost[i] * step.dt, 0.0)
        for i in range(wp.static(len(ends))):
            end[robot, wp.static(ends[i][0])] = wp.static(ends[i][1])(step, robot)
        for i in range(wp.static(len(rewards))):
            reward[robot, wp.static(rewards[i][0])] = wp.static(rewards[i][1])(step, robot)
        for i in range(wp.static(len(metrics))):
            metric[robot, wp.static(metrics[i][0])] = wp.static(metrics[i][1])(step, robot)
        step.begun[robot] = True

    return judge


@wp.kernel(enable_backward=False)
def conclude(
    ends: wp.array2d(dtype=wp.bool),  # type: ignore[valid-type]
    time_out: wp.array(dtype=wp.bool),  # type: ignore[valid-type]
    terminated: wp.array(dtype=wp.bool),  # type: ignore[valid-type]
    truncated: wp.array(dtype=wp.bool),  # type: ignore[valid-type]
    done: wp.array(dtype=wp.bool),  # type: ignore[valid-type]
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
    values: wp.array2d(dtype=float),  # type: ignore[valid-type]
    weights: wp.array(dtype=float),  # type: ignore[valid-type]
    scale: float,
    rates: wp.array2d(dtype=float),  # type: ignore[valid-type]
    sums: wp.array2d(dtype=float),  # type: ignore[valid-type]
    rewards: wp.array(dtype=float),  # type: ignore[valid-type]
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
    values: wp.array2d(dtype=float),  # type: ignore[valid-type]
    sums: wp.array2d(dtype=float),  # type: ignore[valid-type]
    steps: wp.array(dtype=wp.int64),  # type: ignore[valid-type]
):
    """Add metrics up over episodes."""
    robot = wp.tid()
    for term in range(values.shape[1]):
        sums[robot, term] = sums[robot, term] + values[robot, term]
    steps[robot] = steps[robot] + wp.int64(1)


@wp.kernel(enable_backward=False)
def sense(
    table: wp.array2d(dtype=float),  # type: ignore[valid-type]
    noise: wp.array2d(dtype=float),  # type: ignore[valid-type]
    draw: wp.array(dtype=int),  # type: ignore[valid-type]
    low: wp.array(dtype=float),  # type: ignore[valid-type]
    span: wp.array(dtype=float),  # type: ignore[valid-type]
    scale: wp.array(dtype=float),  # type: ignore[valid-type]
):
    """Add noise, drawn from [0, 1), to some columns of observations, and scale all."""
    robot, column = wp.tid()
    value = table[robot, column]
    if draw[column] >= 0:
        value += low[column] + span[column] * noise[robot, draw[column]]
    table[robot, column] = value * scale[column]
