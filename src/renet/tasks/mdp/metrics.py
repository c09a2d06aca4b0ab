"""Metrics, logged as means over an episode's steps."""

from mjlab.envs import ManagerBasedRlEnv
from torch import Tensor

from renet.interface import HEIGHT_MAP_X, HEIGHT_MAP_Y


def reward_clipped(env: ManagerBasedRlEnv) -> Tensor:
    """1 where the sum of a step's rewards is negative, so that the learner counts it as 0, [N]."""
    return (env.reward_buf < 0.0).float()


def reward_term(env: ManagerBasedRlEnv, name: str) -> Tensor:
    """Value of the reward `name` before its weight, which may be zero, [N]."""
    manager = env.reward_manager
    term = manager.get_term_cfg(name)
    if term.weight == 0.0:
        return term.func(env, **term.params)
    return manager._step_reward[:, manager.active_terms.index(name)] / term.weight


def near_edge(env: ManagerBasedRlEnv, reach: float = 0.5, relief: float = 0.08) -> Tensor:
    """1 where the last observed height map has an edge close to the base, [N].

    Args:
        env: The environment.
        reach: Half-width of the square around the base, m.
        relief: Difference of heights in the square above which there is an edge, m.
    """
    rows = indices_within(reach, HEIGHT_MAP_X)
    columns = indices_within(reach, HEIGHT_MAP_Y)
    height_map = env.obs_buf["height_map"].unflatten(-1, (len(HEIGHT_MAP_X), -1))  # type: ignore[union-attr]
    square = height_map[:, rows, columns].flatten(1)
    return (square.amax(-1) - square.amin(-1) > relief).float()


def clipped_near_edge(env: ManagerBasedRlEnv) -> Tensor:
    """1 where both `reward_clipped` and `near_edge` are 1, [N].

    There a robot learns nothing from its attempts to climb.
    """
    return reward_clipped(env) * near_edge(env)


def indices_within(reach: float, axis: tuple[float, ...]) -> slice:
    """Return the indices of an ascending axis whose values are closer to zero than `reach`."""
    inside = [index for index, value in enumerate(axis) if abs(value) < reach]
    return slice(inside[0], inside[-1] + 1)
