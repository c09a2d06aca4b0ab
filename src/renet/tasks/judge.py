"""One kernel that judges a control step: costs, reasons to end, rewards and metrics."""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportOperatorIssue=false, reportReturnType=false

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
        """Of the last step times its dt, order of interface.CONSTRAINTS, [N, 3]."""

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
        step: Step,
        end: wp.array2d(dtype=wp.bool),
        reward: wp.array2d(dtype=float),
        metric: wp.array2d(dtype=float),
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
