"""Randomisation that mjlab lacks."""

import math

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.event_manager import requires_model_fields
from torch import Tensor


@requires_model_fields("actuator_biasprm")
def servo_damping(
    env: ManagerBasedRlEnv, env_ids: Tensor | None, multiples: tuple[float, float]
) -> None:
    """Multiply the nominal damping (Kd) of servos by a random number for each robot.

    All motors of a robot share the number, because they are of the same make.

    Args:
        env: The environment.
        env_ids: Robots to randomise; None means all.
        multiples: Smallest and largest number, whose logarithm is uniform.
    """
    ids = torch.arange(env.num_envs, device=env.device) if env_ids is None else env_ids.long()
    low = math.log(multiples[0])
    high = math.log(multiples[1])
    multiple = torch.exp(low + (high - low) * torch.rand(len(ids), 1, device=env.device))
    nominal = env.sim.get_default_field("actuator_biasprm")[:, 2]
    env.sim.model.actuator_biasprm[ids, :, 2] = nominal * multiple
