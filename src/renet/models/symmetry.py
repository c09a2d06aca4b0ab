"""Mirror image of a robot: observations and actions with left and right exchanged.

The mirror is the plane through the base's x and z axes. A robot whose legs are built alike on both
sides moves in the mirror as it would if it were told the mirrored actions.
"""

import torch
from torch import Tensor

from renet.interface import JOINTS, PROPRIOCEPTION

OTHER_SIDE = {"FR": "FL", "FL": "FR", "RR": "RL", "RL": "RR"}
"""Leg on the other side of each leg."""
VECTOR = (1.0, -1.0, 1.0)
"""Signs of a vector in the mirror: its part along y changes its direction."""
ROTATION = (-1.0, 1.0, -1.0)
"""Signs of an angular velocity in the mirror: rotation about y keeps its direction."""
MIRRORED_TWIST = (1.0, -1.0, -1.0)
"""Signs of a command (v_x, v_y, omega_z) in the mirror; those of a heading (c_x, sin e, cos e)
would be others."""


def _joint_on_other_side(name: str) -> int:
    """Return the index in JOINTS of the joint on the other side."""
    leg, joint = name.split("_", 1)
    return JOINTS.index(f"{OTHER_SIDE[leg]}_{joint}")


JOINT_ORDER = tuple(_joint_on_other_side(name) for name in JOINTS)
"""Index of the joint that takes each joint's place in the mirror."""
JOINT_SIGNS = tuple(-1.0 if "hip" in name else 1.0 for name in JOINTS)
"""Signs of joint angles in the mirror: hips turn about x, thighs and calves about y."""


def _proprioception_mirror() -> tuple[list[int], list[float]]:
    """Return index and sign of the number that takes each number's place in the mirror."""
    signs_of = {
        "base_angular_velocity": ROTATION,
        "projected_gravity": VECTOR,
        "command": MIRRORED_TWIST,
    }
    order: list[int] = []
    signs: list[float] = []
    for term in PROPRIOCEPTION:
        start = len(order)
        if term.name in signs_of:
            order += range(start, start + term.size)
            signs += signs_of[term.name]
        else:
            # One number for each joint.
            order += [start + joint for joint in JOINT_ORDER]
            signs += JOINT_SIGNS
    return order, signs


class Mirror:
    """Mirror for tensors of one device."""

    def __init__(self, device: str | torch.device) -> None:
        """Put the constants on the device, so that to use them never waits for it."""
        order, signs = _proprioception_mirror()
        self._proprioception_order = torch.tensor(order, device=device)
        self._proprioception_signs = torch.tensor(signs, device=device)
        self._joint_order = torch.tensor(JOINT_ORDER, device=device)
        self._joint_signs = torch.tensor(JOINT_SIGNS, device=device)

    def proprioception(self, proprioception: Tensor) -> Tensor:
        """Mirror proprioceptions [..., 45], whose command is a twist."""
        exchanged = proprioception.index_select(-1, self._proprioception_order)
        return exchanged * self._proprioception_signs

    def action(self, action: Tensor) -> Tensor:
        """Mirror actions or joint angles, [..., 12] in the order of JOINTS."""
        return action.index_select(-1, self._joint_order) * self._joint_signs

    def image(self, depth: Tensor) -> Tensor:
        """Mirror depth images [..., rows, columns]."""
        return depth.flip(-1)
