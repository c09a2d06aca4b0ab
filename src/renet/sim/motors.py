"""Delays of targets and torque–speed curves, which MuJoCo's servos lack.

Both act between two physics steps. The native engine applies them in the call that takes all steps
(`drive` in native/engine.cpp); `Motors.drive` does the same before each step of any engine.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab.sim.sim import Simulation
from torch import Tensor

NO_MOTORS: dict[str, Any] = {
    "actuators": 0,
    "substeps": 1,
    "kept": 0,
    "lag": None,
    "targets": None,
    "speed": None,
    "dof": None,
    "limits": None,
    "stride": 0,
}
"""Fields of the struct Motors of engine.cpp for motors without delays and torque–speed curves."""


class Motors:
    """Delays and torque–speed curves of actuators that each drive a hinge, without a gear.

    Initially delays are zero and no-load speeds infinite.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        device: str = "cpu",
        substeps: int = 1,
        max_lag: int = 0,
        falls_with_speed: bool = False,
    ) -> None:
        """Allocate delays, no-load speeds and old targets of N environments.

        Args:
            model: Model of one environment.
            num_envs: Number N of environments.
            device: torch's name of the device.
            substeps: Physics steps from one target to the next.
            max_lag: Largest `lag` in physics steps.
            falls_with_speed: Limit torque by `no_load_speed`.
        """
        shape = (num_envs, model.nu)
        self.lag = torch.zeros(shape, dtype=torch.int32, device=device)
        """Delays of targets in physics steps, [N, nu]; they may change at any time."""
        self.no_load_speed = torch.full(shape, math.inf, device=device)
        """Speed at which a motor has no torque, [N, nu] rad/s. The largest torque falls linearly
        from the limit at rest; a motor that brakes has the limit at rest."""
        self.max_lag = max_lag
        self.falls_with_speed = falls_with_speed
        self._substeps = substeps
        # The newest target, and before it those that a delay may still need.
        count = 1 + math.ceil(max_lag / substeps) if max_lag else 0
        self._targets = torch.full((num_envs, count, model.nu), math.nan, device=device)
        dof = model.jnt_dofadr[model.actuator_trnid[:, 0]].astype(np.int32)
        self._dof = torch.as_tensor(dof, device=device)
        self._limits: Tensor | None = None
        self._step = 0

    def reset(self, ids: Tensor | slice) -> None:
        """Drop the targets of some environments; the next one takes the place of all old ones."""
        self._targets[ids] = math.nan

    def copy_rows(self, source: Tensor) -> None:
        """Copy delays and speeds from the environments `source`, [N], one for each."""
        self.lag[:] = self.lag[source]
        self.no_load_speed[:] = self.no_load_speed[source]

    def drive(self, sim: Simulation) -> None:
        """Set controls and torque limits for the next physics step of a simulation.

        Controls must hold the newest target. With torque–speed curves, each environment must have
        its own `actuator_forcerange`; its values at the first call are the limits at rest.
        """
        if self._targets.shape[1]:
            self._delay(sim.data.ctrl)
        if self.falls_with_speed:
            self._limit(sim)
        self._step = (self._step + 1) % self._substeps

    def _delay(self, ctrl: Any) -> None:
        """Replace the newest targets, [N, nu], by those whose delay is over."""
        # At the beginning of a control step, shift the targets and store the new one.
        if self._step == 0:
            newest = ctrl[:].clone()
            older = self._targets[:, :-1].clone()
            has_none = self._targets[:, :1].isnan()
            self._targets[:, 1:] = torch.where(has_none, newest[:, None], older)
            self._targets[:, 0] = newest
        # A delay in physics steps becomes the age of a target in control steps, rounded up.
        remaining_lag = (self.lag - self._step).clamp_min(0)
        age = (remaining_lag + self._substeps - 1) // self._substeps
        ctrl[:] = self._targets.gather(1, age.long()[:, None]).squeeze(1)

    def _limit(self, sim: Simulation) -> None:
        """Limit torque by speed."""
        limits = sim.model.actuator_forcerange
        at_rest = self._limits
        if at_rest is None:
            at_rest = limits[:].clone()
            self._limits = at_rest
        speed = sim.data.qvel[:, self._dof.long()]
        lower_share = torque_share(-speed, self.no_load_speed)
        upper_share = torque_share(speed, self.no_load_speed)
        limits[:] = at_rest * torch.stack((lower_share, upper_share), dim=-1)

    def fields(self, limits: np.ndarray) -> dict[str, Any]:
        """Return the fields of the struct Motors of engine.cpp, on a CPU.

        Args:
            limits: Lowest and highest torque at rest, [N, nu, 2] or [1, nu, 2] N m, in Warp's
                memory.
        """
        return {
            "actuators": len(self._dof),
            "substeps": self._substeps,
            "kept": self._targets.shape[1],
            "lag": self.lag.numpy(),
            "targets": self._targets.numpy(),
            "speed": self.no_load_speed.numpy() if self.falls_with_speed else None,
            "dof": self._dof.numpy(),
            "limits": limits,
            "stride": limits.strides[0] if len(limits) > 1 else 0,
        }


def torque_share(speed: Tensor, no_load_speed: Tensor) -> Tensor:
    """Compute a motor's largest torque as a share of that at rest, from 0 to 1.

    Args:
        speed: Speed in the direction of the torque, rad/s.
        no_load_speed: Speed at which the motor has no torque, rad/s.
    """
    return (1.0 - speed / no_load_speed).clamp(0.0, 1.0)
