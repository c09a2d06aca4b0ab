"""mjlab's observation manager with one table for all terms that are written in Warp."""

# Warp compiles annotations and arithmetic that pyright takes for Python's.
# pyright: reportGeneralTypeIssues=false, reportInvalidTypeForm=false

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import warp as wp
from mjlab.managers.observation_manager import ObservationManager, ObservationTermCfg
from mjlab.utils.noise import UniformNoiseCfg
from torch import Tensor

from renet.tasks.terms import Launch, filling, is_in_warp

if TYPE_CHECKING:
    from renet.tasks.env import RenetEnv


class StackedObservations(ObservationManager):
    """Terms in Warp are columns of one table; torch's are handed on without being copied.

    Both only in groups that are neither delayed nor remembered, clipped or checked. Results are
    mjlab's.
    """

    def __init__(self, cfg: dict, env: RenetEnv) -> None:
        super().__init__(cfg, env)
        self._columns: dict[str, list[slice | None]] = {}
        """Of each term of the groups above; None for torch's."""
        terms, scales, noises = [], [], []
        for name, group in self._group_obs_term_cfgs.items():
            if not (self._is_joined(name) and all(map(_is_plain, group))):
                continue
            self._columns[name] = []
            for term in group:
                if not is_in_warp(term.func):
                    self._columns[name].append(None)
                    continue
                first, one = len(scales), torch.ones(term.func.size)
                terms.append((first, term.func.compiled))
                scales += (one if term.scale is None else one * term.scale.cpu()).tolist()
                noises += _bounds(term, one)
                self._columns[name].append(slice(first, len(scales)))
        noisy = [bounds is not None for bounds in noises]
        draws = [sum(noisy[:i]) if is_noisy else -1 for i, is_noisy in enumerate(noisy)]
        low, high = torch.tensor([b or (0.0, 0.0) for b in noises]).reshape(len(noises), 2).T
        count, device = env.num_envs, env.device
        self._table = torch.zeros(count, len(scales), device=device)
        self._noise = torch.zeros(count, sum(noisy), device=device)
        self._sensed = self._table
        columns = [torch.tensor(draws, dtype=torch.int32), low, high - low, torch.tensor(scales)]
        columns = [column.contiguous().to(device) for column in columns]
        self._fill = Launch(filling(tuple(terms)), count, [env.watched, self._table], device)
        inputs = [self._table, self._noise, *columns]
        self._sense = Launch(sense, tuple(self._table.shape), inputs, device)

    def compute(
        self, update_history: bool = False, env_ids: Tensor | None = None
    ) -> dict[str, Tensor | dict[str, Tensor]]:
        """See ObservationManager.compute."""
        if update_history or self._obs_buffer is None:
            self._fill()
            if self._noise.shape[1]:
                self._noise.uniform_()
            self._sense()
            self._sensed = self._table.clone()  # Whoever observes may keep it.
        return super().compute(update_history, env_ids)

    def compute_group(
        self, group_name: str, update_history: bool = False, env_ids: Tensor | None = None
    ) -> Tensor | dict[str, Tensor]:
        """See ObservationManager.compute_group."""
        if group_name not in self._columns:
            return super().compute_group(group_name, update_history, env_ids)
        values = []
        for term, columns in zip(
            self._group_obs_term_cfgs[group_name], self._columns[group_name], strict=True
        ):
            if columns is None:
                values.append(term.func(self._env, **term.params))
            else:
                values.append(self._sensed[:, columns])
        return values[0] if len(values) == 1 else torch.cat(values, dim=-1)

    def _is_joined(self, group: str) -> bool:
        """Whether mjlab only puts a group's terms side by side."""
        unchecked = self.cfg[group].nan_policy == "disabled"
        in_rows = self._group_obs_concatenate_dim[group] == -1
        return unchecked and in_rows and self._group_obs_concatenate[group]


def _is_plain(term: ObservationTermCfg) -> bool:
    """Whether a term is one number after the other, at most with noise and a scale if in Warp."""
    if term.delay_max_lag or term.history_length or term.clip:
        return False
    if is_in_warp(term.func):
        noise = term.noise
        return noise is None or (isinstance(noise, UniformNoiseCfg) and noise.operation == "add")
    return term.noise is None and term.scale is None


def _bounds(term: ObservationTermCfg, one: Tensor) -> list[tuple[float, float] | None]:
    """Noise of each of a term's columns."""
    if term.noise is None:
        return [None] * len(one)
    assert isinstance(term.noise, UniformNoiseCfg)
    low, high = (one * torch.as_tensor(end) for end in (term.noise.n_min, term.noise.n_max))
    return list(zip(low.tolist(), high.tolist(), strict=True))


@wp.kernel(enable_backward=False)
def sense(
    table: wp.array2d(dtype=float),
    noise: wp.array2d(dtype=float),
    draw: wp.array(dtype=int),
    low: wp.array(dtype=float),
    span: wp.array(dtype=float),
    scale: wp.array(dtype=float),
):
    """Add noise, drawn from [0, 1), to some columns of observations, and scale all."""
    robot, column = wp.tid()  # type: ignore[misc]
    value = table[robot, column]
    if draw[column] >= 0:
        value += low[column] + span[column] * noise[robot, draw[column]]
    table[robot, column] = value * scale[column]
