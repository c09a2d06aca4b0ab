"""A floating base's state, read from MuJoCo's arrays in few operations."""

from __future__ import annotations

import torch
from mjlab.entity import EntityData
from torch import Tensor


class FloatingBase(EntityData):
    """EntityData whose base's position, rotation and velocity are not derived from quaternions.

    A free joint's velocities are the base's: linear in the world frame, angular in its own. They
    are as new as the state; positions and rotations are those of the engine's last run.
    """

    def __init__(self, data: EntityData) -> None:
        """Stand in for the data of an entity with a free joint."""
        super().__init__(**vars(data))
        self._body = int(self.indexing.root_body_id)
        address = self.indexing.free_joint_v_adr.tolist()
        self._linear, self._angular = (
            slice(address[0], address[3]),
            slice(address[3], address[5] + 1),
        )

    @property
    def root_link_pos_w(self) -> Tensor:
        """m, [N, 3]."""
        return self.data.xpos[:, self._body].clone()

    @property
    def root_link_lin_vel_w(self) -> Tensor:
        """m/s, [N, 3]."""
        return self.data.qvel[:, self._linear].clone()

    @property
    def root_link_lin_vel_b(self) -> Tensor:
        """m/s, [N, 3]."""
        return (self.data.qvel[:, None, self._linear] @ self._rotation).squeeze(1)

    @property
    def root_link_ang_vel_b(self) -> Tensor:
        """rad/s, [N, 3]."""
        return self.data.qvel[:, self._angular].clone()

    @property
    def projected_gravity_b(self) -> Tensor:
        """Downward unit vector, [N, 3]."""
        return -self._rotation[:, 2]

    @property
    def heading_w(self) -> Tensor:
        """Yaw of the base's forward axis, rad, [N]."""
        return torch.atan2(self._rotation[:, 1, 0], self._rotation[:, 0, 0])

    @property
    def _rotation(self) -> Tensor:
        """Base to world, [N, 3, 3]."""
        return self.data.xmat[:, self._body]
