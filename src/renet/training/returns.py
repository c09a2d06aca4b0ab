"""Generalised advantage estimation for the reward and every cost at once."""

from __future__ import annotations

import torch
from torch import Tensor


def advantages(
    payoff: Tensor, value: Tensor, last_value: Tensor, done: Tensor, gamma: float, lam: float
) -> Tensor:
    """GAE of each column (Schulman et al. 2016).

    Args:
        payoff, value: [T, N, K]. last_value: [N, K], of the state after the last step.
        done: [T, N] bool; nothing is carried over the end of an episode.

    Returns:
        Advantages [T, N, K]; returns are advantages + value.
    """
    result = torch.empty_like(payoff)
    running = torch.zeros_like(last_value)
    next_value = last_value
    for step in reversed(range(payoff.shape[0])):
        alive = (~done[step]).unsqueeze(-1).to(payoff.dtype)
        delta = payoff[step] + gamma * alive * next_value - value[step]
        running = delta + gamma * lam * alive * running
        result[step] = running
        next_value = value[step]
    return result
