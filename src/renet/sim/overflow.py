"""Overflow of MuJoCo Warp's buffers, after which robots fall through the ground."""

import warnings
from typing import Any

import torch
import warp as wp
from mujoco_warp._src.types import OverflowType

BUFFERS = {
    "contacts": (OverflowType.BROADPHASE | OverflowType.NARROWPHASE, "nconmax"),
    "constraints": (OverflowType.NEFC | OverflowType.NJMAX_NNZ, "njmax"),
}
"""Flags of the engine for each kind of overflow, and the field of SimulationCfg to increase."""


class OverflowWatch:
    """Count of environments whose buffers overflowed; only its report waits for the device."""

    def __init__(self, simulation: Any) -> None:
        """Watch an mjlab Simulation that MuJoCo Warp steps."""
        self._flags = wp.to_torch(simulation.wp_data.overflow)
        self._collected = torch.zeros_like(self._flags)

    def look(self) -> None:
        """Collect the engine's flags, which it clears when it resets an environment."""
        self._collected |= self._flags

    def report(self) -> dict[str, float]:
        """Count the environments that overflowed since the last report, by buffer.

        This warns if there are any.
        """
        masks = torch.tensor(
            [int(flags) for flags, _ in BUFFERS.values()], device=self._collected.device
        )
        counts = ((self._collected.unsqueeze(-1) & masks) != 0).sum(0).tolist()
        self._collected.zero_()
        for (name, (_, setting)), count in zip(BUFFERS.items(), counts, strict=True):
            if count:
                warnings.warn(
                    f"more {name} than fit the engine's buffers: physics is wrong there. "
                    f"Raise `sim.{setting}` of the task",
                    stacklevel=2,
                )
        return {f"overflow_{name}": count for name, count in zip(BUFFERS, counts, strict=True)}
