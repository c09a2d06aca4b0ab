"""Motion of simulated robots: true values that their own sensors do not measure."""

from dataclasses import dataclass

import numpy as np
import torch

from renet.evaluation.env import SimEnv
from renet.interface import LEGS
from renet.tasks.mdp.base_state import base_heading, base_position, base_velocity, rotated
from renet.tasks.mdp.commands import goal
from renet.tasks.mdp.rewards import joint_energy
from renet.tasks.sensors import FEET_CONTACT


@dataclass(frozen=True)
class Motion:
    """The motion of N robots at one control step."""

    twist: np.ndarray
    """(v_x, v_y) in m/s and omega_z in rad/s of the base, in its own frame without tilt, [N, 3]."""
    position: np.ndarray
    """Horizontal position of the base, [N, 2] m, in a frame at the start, x along the commanded
    heading."""
    slip: np.ndarray
    """Mean speed of the feet that touch the ground, [N] m/s."""
    power: np.ndarray
    """Sum of |torque * joint velocity|, [N] W."""
    torque: np.ndarray
    """Largest |torque| of a joint, [N] N m."""


class MotionSensor:
    """Reads the motion of an environment's robots, once a control step."""

    def __init__(self, env: SimEnv) -> None:
        self._env = env.env
        self._robot = self._env.scene["robot"]
        feet, _ = self._robot.find_sites(LEGS)
        self._feet = self._robot.indexing.site_ids[feet]
        self._feet_before: torch.Tensor | None = None

    def read(self) -> Motion:
        """Read the motion after the newest step; slip is 0 at the first."""
        env = self._env
        robot = self._robot
        # The velocity is turned into the base's heading, the position into the commanded one.
        velocity = rotated(base_velocity(env)[:, :2], -base_heading(env))
        turn_rate = env.sim.data.qvel[:, robot.indexing.free_joint_v_adr[5]]
        way = (base_position(env) - env.scene.env_origins)[:, :2]
        return Motion(
            twist=torch.cat((velocity, turn_rate.unsqueeze(-1)), dim=-1).numpy(),
            position=rotated(way, -goal(env).yaw).numpy(),
            slip=self._slip().numpy(),
            power=joint_energy(env).numpy(),
            torque=robot.data.qfrc_actuator.abs().amax(-1).numpy(),
        )

    def _slip(self) -> torch.Tensor:
        """Compute the mean speed of the feet in contact, [N] m/s, from their last two positions."""
        env = self._env
        feet = env.sim.data.site_xpos[:, self._feet, :2].clone()
        before = feet if self._feet_before is None else self._feet_before
        self._feet_before = feet
        # A foot in the air does not slip.
        touches = env.scene[FEET_CONTACT].data.found > 0
        speed = (feet - before).norm(dim=-1) / env.step_dt
        return (speed * touches).sum(-1) / touches.sum(-1).clamp_min(1)
