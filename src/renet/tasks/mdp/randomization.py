"""Randomisation beyond mjlab's."""

import math

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.event_manager import requires_model_fields
from torch import Tensor


@requires_model_fields("actuator_biasprm")
def servo_damping(
    env: ManagerBasedRlEnv, env_ids: Tensor | None, multiples: tuple[float, float]
) -> None:
    """Multiply the nominal damping (Kd) of servos by a number drawn for each robot.

    All motors of a robot are of one make: they share the number.

    Args:
        env: environment. env_ids: robots to draw for; None: all.
        multiples: smallest and largest number; its logarithm is uniform.
    """
    ids = torch.arange(env.num_envs, device=env.device) if env_ids is None else env_ids.long()
    low, high = (math.log(multiple) for multiple in multiples)
    drawn = torch.exp(low + (high - low) * torch.rand(len(ids), 1, device=env.device))
    nominal = env.sim.get_default_field("actuator_biasprm")[:, 2]
    env.sim.model.actuator_biasprm[ids, :, 2] = nominal * drawn
