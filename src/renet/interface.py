"""Names, orders, units and sizes shared by training, evaluation and the robot.

All indices elsewhere are derived from these tables. The base frame is x forward, y left, z up;
quaternions are (w, x, y, z).
"""

import math
from dataclasses import dataclass
from typing import Literal

Engine = Literal["auto", "native", "warp"]
"""Physics engines of training and studies; auto: native (C MuJoCo) on a CPU, warp on a GPU, which
studies do not use."""
Terrain = Literal[
    "flat", "rough", "obstacles", "stairs", "stairs_up", "stairs_down", "gap", "platform"
]
"""Grounds that a robot walks on; stairs go down."""
PilotMode = Literal["memory", "switch", "camera", "blind"]
"""Who decides whether VP drives. memory: all monitors, which withhold bad images, and VP's memory
of the ground. switch: the paper's switch, the reconstruction loss against beta, filtered. camera:
VP always. blind: OP always."""

Unseen = Literal["walk", "slow", "stop"]
"""What a robot that remembers does at the end of the ground that it has seen. walk: it goes on, as
told. slow: it goes on slowly. stop: it stands until it sees again, or is told another way."""

LEGS = ("FR", "FL", "RR", "RL")
JOINTS = tuple(f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf"))
TRUNK = "trunk"
"""Name of a robot's base body in its MJCF."""

CONSTRAINTS = ("joint_position", "joint_velocity", "torque")
"""The paper's constraint costs, in the order of every cost tensor."""

FALL_TILT = math.radians(80.0)
"""Angle between the base's z axis and up at which a robot has fallen, rad: there an episode of
training or of a study ends, and a real robot brakes."""
TARGET_RATE = 40.0
"""Fastest change of a joint target that a robot is sent, rad/s."""
JOINT_MARGIN = 0.2
"""How far beyond its range a joint may be measured before the robot brakes, rad."""
MAX_JOINT_SPEED = 60.0
"""Joint speed above which a robot brakes, rad/s; twice what a Go1's motors reach: a sensor that
reads more is wrong."""
MAX_BASE_RATE = 30.0
"""Angular velocity of the base, around any of its axes, above which a robot brakes, rad/s."""

MAX_SPEED = 1.0
"""Fastest forward command of training, m/s (paper)."""
MAX_REVERSE = 0.6
"""Fastest backward command, m/s."""
MAX_SIDEWAYS = 0.5
"""Fastest sideways command, to either side, m/s."""
MAX_TURN = 1.0
"""Fastest turn that training asks for, rad/s."""
TURN_GAIN = 1.5
"""Turn rate that a robot off its heading is told, rad/s per rad; at most MAX_TURN."""

CONTROL_DT = 0.02
"""Seconds between policy ticks (50 Hz)."""
STEPS_PER_TICK = 5
"""Policy ticks per estimator and vision tick (10 Hz)."""
TICK_DT = CONTROL_DT * STEPS_PER_TICK
"""Seconds between two estimator ticks, and between two depth images (10 Hz, paper)."""
PHYSICS_DT = 0.005
"""Seconds between physics steps, and the selector's default update period (200 Hz)."""

HISTORY = 10
"""H1, the number of proprioceptions an estimator sees (paper)."""
FRAMES = 2
"""H2, the number of depth images an estimator sees (paper)."""
LATENT = 64
"""Width of each estimator's GRU, hence of h_b and h_v (paper)."""

DEPTH_SHAPE = (48, 64)
"""Rows, columns of a depth image (paper); row 0 is the top."""
DEPTH_RANGE = 2.0
"""Metres at which depth is capped (paper); images are normalised by it to [0, 1]."""


@dataclass(frozen=True)
class Term:
    """One block of the proprioception vector: `size` numbers in `unit`, multiplied by `scale`."""

    name: str
    size: int
    unit: str
    scale: float = 1.0


Told = Literal["twist", "heading"]
"""How a policy is told where to go: by a velocity and a turn rate of its base, or by a speed and
the angle to a heading (the paper's goal, and bundles of renet 0.1)."""
TOLD: dict[Told, Term] = {
    "twist": Term("command", 3, "v_x, v_y in m/s, omega_z in rad/s, base frame"),
    "heading": Term("command", 3, "c_x in m/s; sin, cos of (c_yaw - yaw)"),
}
PROPRIOCEPTION = (
    Term("base_angular_velocity", 3, "rad/s, base frame", 0.25),
    Term("projected_gravity", 3, "unit vector, base frame"),
    TOLD["twist"],
    Term("joint_position", 12, "rad, minus the default pose"),
    Term("joint_velocity", 12, "rad/s", 0.05),
    Term("last_action", 12, "policy units"),
)
HEADING_PROPRIOCEPTION = tuple(
    TOLD["heading"] if term.name == "command" else term for term in PROPRIOCEPTION
)
"""What policies observe that are told a heading."""
PROPRIOCEPTION_SIZE = sum(term.size for term in PROPRIOCEPTION)
ACTION_SIZE = len(JOINTS)

HEIGHT_MAP_X = tuple(round(-0.45 + 0.15 * i, 2) for i in range(12))
HEIGHT_MAP_Y = tuple(round(-0.75 + 0.15 * i, 2) for i in range(11))
"""Metres ahead of and left of the base, in the yaw-aligned base frame; the 2.5D map m_t is
flattened with y fastest (index = i_x * len(HEIGHT_MAP_Y) + i_y)."""
HEIGHT_MAP_SIZE = len(HEIGHT_MAP_X) * len(HEIGHT_MAP_Y)
FAR_MAP_X = tuple(round(1.35 + 0.15 * i, 2) for i in range(6))
FAR_MAP_Y = (-0.6, -0.3, 0.0, 0.3, 0.6)
"""The same of the ground beyond, as far as images reach: taught, so that VP remembers it, and read
by nobody."""
FAR_MAP_SIZE = len(FAR_MAP_X) * len(FAR_MAP_Y)
MAP_HEIGHT = 0.3
"""Height of the base above the ground that reads as zero in the map, m (Extreme Parkour)."""
NUM_FEET = len(LEGS)


def proprioception_slices() -> dict[str, slice]:
    """The place of each term of `PROPRIOCEPTION` in the vector, by name."""
    slices, start = {}, 0
    for term in PROPRIOCEPTION:
        slices[term.name] = slice(start, start + term.size)
        start += term.size
    return slices
