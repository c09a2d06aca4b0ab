"""Contacts and constraints that overflow MuJoCo Warp's buffers, so that robots fall through."""

import warnings
from typing import Any

import torch
import warp as wp
from mujoco_warp._src.types import OverflowType

BUFFERS = {
    "contacts": (OverflowType.BROADPHASE | OverflowType.NARROWPHASE, "nconmax"),
    "constraints": (OverflowType.NEFC | OverflowType.NJMAX_NNZ, "njmax"),
}
"""The engine's marks of each kind of overflow, and the setting of SimulationCfg to raise."""


class OverflowWatch:
    """Counts environments whose buffers overflowed, without waiting for the device to look."""

    def __init__(self, simulation: Any) -> None:
        """Watch an mjlab Simulation that MuJoCo Warp steps."""
        self._marks = wp.to_torch(simulation.wp_data.overflow)
        self._seen = torch.zeros_like(self._marks)

    def look(self) -> None:
        """Collect the engine's marks, which it erases when it resets an environment."""
        self._seen |= self._marks

    def report(self) -> dict[str, float]:
        """Environments that overflowed since the last report, by buffer; warns if there are any."""
        masks = torch.tensor([int(m) for m, _ in BUFFERS.values()], device=self._seen.device)
        counts = ((self._seen.unsqueeze(-1) & masks) != 0).sum(0).tolist()
        self._seen.zero_()
        for (name, (_, setting)), count in zip(BUFFERS.items(), counts, strict=True):
            if count:
                warnings.warn(
                    f"more {name} than fit the engine's buffers: physics is wrong there. "
                    f"Raise `sim.{setting}` of the task",
                    stacklevel=2,
                )
        return {f"overflow_{name}": count for name, count in zip(BUFFERS, counts, strict=True)}
