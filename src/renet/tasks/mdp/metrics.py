"""Metrics, logged as means over an episode's steps."""

from mjlab.envs import ManagerBasedRlEnv
from torch import Tensor

from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y


def reward_clipped(env: ManagerBasedRlEnv) -> Tensor:
    """1 where the step's summed reward is negative, which the learner takes for zero, [N]."""
    return (env.reward_buf < 0.0).float()


def reward_term(env: ManagerBasedRlEnv, name: str) -> Tensor:
    """Value of the reward `name` before its weight, which may be zero, [N]."""
    manager = env.reward_manager
    term = manager.get_term_cfg(name)
    if term.weight == 0.0:
        return term.func(env, **term.params)
    return manager._step_reward[:, manager.active_terms.index(name)] / term.weight


def near_edge(env: ManagerBasedRlEnv, reach: float = 0.5, relief: float = 0.08) -> Tensor:
    """1 where there is an edge close to the base, in the last observed height map, [N].

    It is a difference of heights above `relief`, m, in the square of half-width `reach`, m.
    """
    rows, columns = (indices_within(reach, axis) for axis in (HEIGHT_MAP_X, HEIGHT_MAP_Y))
    observed = env.obs_buf["height_map"].unflatten(-1, (len(HEIGHT_MAP_X), -1))  # type: ignore[union-attr]
    around = observed[:, rows, columns].flatten(1)
    return (around.amax(-1) - around.amin(-1) > relief).float()


def clipped_near_edge(env: ManagerBasedRlEnv) -> Tensor:
    """1 where `reward_clipped` and `near_edge` both are, [N]: there trying teaches nothing."""
    return reward_clipped(env) * near_edge(env)


def indices_within(reach: float, axis: tuple[float, ...]) -> slice:
    """Indices of an ascending axis whose values are closer to zero than `reach`."""
    inside = [index for index, value in enumerate(axis) if abs(value) < reach]
    return slice(inside[0], inside[-1] + 1)
