"""What servos of MuJoCo lack: targets that come late, and torque that falls with speed.

Both change between two physics steps. The native engine does it in the call that takes all steps
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

IDEAL: dict[str, Any] = {
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
"""The struct Motors of engine.cpp where nothing changes between physics steps."""


class Motors:
    """Late targets and torque–speed curves of actuators that each drive a hinge, without a gear.

    At first no target is late, and no-load speeds are infinite.
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
        """Set up for N environments of a model.

        Args:
            model: of one environment. num_envs: N. device: torch's name of the device.
            substeps: physics steps from one target to the next.
            max_lag: largest `lag`, physics steps.
            falls_with_speed: whether torque depends on `no_load_speed`.
        """
        shape = (num_envs, model.nu)
        self.lag = torch.zeros(shape, dtype=torch.int32, device=device)
        """Physics steps by which targets are late, [N, nu]; they may change at any time."""
        self.no_load_speed = torch.full(shape, math.inf, device=device)
        """Speed at which a motor has no torque, [N, nu] rad/s. Below, it falls linearly from the
        limit at rest; a motor that brakes has all of it."""
        self.max_lag = max_lag
        self.falls_with_speed = falls_with_speed
        self._substeps = substeps
        # The newest target first, and as many before it as may still be under way.
        kept = 1 + math.ceil(max_lag / substeps) if max_lag else 0
        self._targets = torch.full((num_envs, kept, model.nu), math.nan, device=device)
        dof = model.jnt_dofadr[model.actuator_trnid[:, 0]].astype(np.int32)
        self._dof = torch.as_tensor(dof, device=device)
        self._limits: Tensor | None = None
        self._step = 0

    def reset(self, ids: Tensor | slice) -> None:
        """Forget the targets of some environments: their next one counts as all before it."""
        self._targets[ids] = math.nan

    def copy_rows(self, source: Tensor) -> None:
        """Give each environment the delays and speeds of another; source: [N] its number."""
        self.lag[:] = self.lag[source]
        self.no_load_speed[:] = self.no_load_speed[source]

    def drive(self, sim: Simulation) -> None:
        """Change controls and torque limits for the next physics step of a simulation.

        Controls must hold the newest target. `actuator_forcerange` must be a field of each
        environment's own; its values at the first call are the limits at rest.
        """
        if self._targets.shape[1]:
            self._delay(sim.data.ctrl)
        if self.falls_with_speed:
            self._limit(sim)
        self._step = (self._step + 1) % self._substeps

    def _delay(self, ctrl: Any) -> None:
        """Replace the newest targets, [N, nu], by those that have arrived."""
        if self._step == 0:
            newest = ctrl[:].clone()
            before = self._targets[:, :-1].clone()
            first = self._targets[:, :1].isnan()
            self._targets[:, 1:] = torch.where(first, newest[:, None], before)
            self._targets[:, 0] = newest
        late = (self.lag - self._step).clamp_min(0)
        age = (late + self._substeps - 1) // self._substeps
        ctrl[:] = self._targets.gather(1, age.long()[:, None]).squeeze(1)

    def _limit(self, sim: Simulation) -> None:
        """Let torque fall with speed."""
        limits = sim.model.actuator_forcerange
        at_rest = self._limits
        if at_rest is None:
            at_rest = self._limits = limits[:].clone()
        speed = sim.data.qvel[:, self._dof.long()]
        shares = [torque_share(-speed, self.no_load_speed), torque_share(speed, self.no_load_speed)]
        limits[:] = at_rest * torch.stack(shares, dim=-1)

    def fields(self, limits: np.ndarray) -> dict[str, Any]:
        """The struct Motors of engine.cpp, on a CPU.

        Args:
            limits: lowest and highest torque at rest, [N, nu, 2] or [1, nu, 2] N m, in Warp's
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
    """Share of its torque at rest that a motor has, 0 to 1.

    `speed` counts in the torque's direction.
    """
    return (1.0 - speed / no_load_speed).clamp(0.0, 1.0)
