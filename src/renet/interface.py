"""Names, orders, units and sizes shared by training, evaluation and the robot.

All indices elsewhere are derived from these tables. The base frame is x forward, y left, z up;
quaternions are (w, x, y, z).
"""

import math
from dataclasses import dataclass
from typing import Literal

Engine = Literal["auto", "native", "warp"]
"""Physics engines of training and studies. auto: native (C MuJoCo) on a CPU, and warp for training
on a GPU."""
Terrain = Literal[
    "flat", "rough", "obstacles", "stairs", "stairs_up", "stairs_down", "gap", "platform"
]
"""Kinds of ground; `stairs` go down."""
OWN_GROUND = "own"
"""Name of the ground of a user's own file."""
PilotMode = Literal["memory", "switch", "camera", "blind"]
"""Decision whether VP or OP drives. memory: by all monitors, which withhold bad images, and by VP's
memory of the ground. switch: by the paper's switch, the filtered comparison of the reconstruction
loss with beta. camera: always VP. blind: always OP."""

Unseen = Literal["walk", "slow", "stop"]
"""Conduct of a robot without images at the end of the ground that it has seen. walk: it walks on.
slow: it walks on slowly. stop: it stands until it sees again, or gets another command."""

LEGS = ("FR", "FL", "RR", "RL")
JOINTS = tuple(f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf"))
TRUNK = "trunk"
"""Name of a robot's base body in its MJCF."""

CONSTRAINTS = ("joint_position", "joint_velocity", "torque")
"""Names of the paper's constraint costs, in the order of all tensors of costs."""

FALL_TILT = math.radians(80.0)
"""Angle between the base's z axis and up at which a robot has fallen, rad: there an episode of
training or of a study ends, and a real robot brakes."""
TARGET_RATE = 40.0
"""Fastest change of a joint target that a robot is sent, rad/s."""
JOINT_MARGIN = 0.2
"""Largest distance of a joint from its range at which a robot does not brake, rad."""
MAX_JOINT_SPEED = 60.0
"""Joint speed above which a robot brakes, rad/s. It is twice the largest speed of a Go1's motors: a
sensor that reads more is defective."""
MAX_BASE_RATE = 30.0
"""Angular velocity of the base, around any of its axes, above which a robot brakes, rad/s."""

MAX_SPEED = 1.0
"""Largest forward speed of commands, m/s (paper)."""
MAX_REVERSE = 0.6
"""Largest backward speed of commands, m/s."""
MAX_SIDEWAYS = 0.5
"""Largest sideways speed of commands, m/s."""
MAX_TURN = 1.0
"""Largest turn rate of commands, rad/s."""
TURN_GAIN = 1.5
"""Commanded turn rate per error of the heading, rad/s per rad; at most MAX_TURN."""

CONTROL_DT = 0.02
"""Time between control steps, s (50 Hz)."""
STEPS_PER_TICK = 5
"""Number of control steps per tick of estimators and vision (10 Hz)."""
TICK_DT = CONTROL_DT * STEPS_PER_TICK
"""Time between two ticks, and between two depth images, s (10 Hz, paper)."""
PHYSICS_DT = 0.005
"""Time between physics steps, and between the selector's updates by default, s (200 Hz)."""

HISTORY = 10
"""Number H1 of proprioceptions that an estimator reads (paper)."""
FRAMES = 2
"""Number H2 of depth images that an estimator reads (paper)."""
LATENT = 64
"""Size of each estimator's GRU, and therefore of h_b and h_v (paper)."""

DEPTH_SHAPE = (48, 64)
"""Rows and columns of a depth image (paper); row 0 is the top."""
DEPTH_RANGE = 2.0
"""Depth at which images are clipped, m (paper); they are divided by it to [0, 1]."""


@dataclass(frozen=True)
class Term:
    """Part of the proprioception vector: `size` numbers in `unit`, multiplied by `scale`."""

    name: str
    size: int
    unit: str
    scale: float = 1.0


Told = Literal["twist", "heading"]
"""Form of a policy's command: velocity and turn rate of the base, or speed and angle to a heading
(the paper's goal, and bundles of renet 0.1)."""
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
"""Observation of policies whose command is a heading."""
PROPRIOCEPTION_SIZE = sum(term.size for term in PROPRIOCEPTION)
ACTION_SIZE = len(JOINTS)

HEIGHT_MAP_X = tuple(round(-0.45 + 0.15 * i, 2) for i in range(12))
HEIGHT_MAP_Y = tuple(round(-0.75 + 0.15 * i, 2) for i in range(11))
"""Positions of the height map's points ahead and to the left of the base, in its yaw-aligned frame,
m. The map m_t is flattened with y fastest (index = i_x * len(HEIGHT_MAP_Y) + i_y)."""
HEIGHT_MAP_SIZE = len(HEIGHT_MAP_X) * len(HEIGHT_MAP_Y)
FAR_MAP_X = tuple(round(1.35 + 0.15 * i, 2) for i in range(6))
FAR_MAP_Y = (-0.6, -0.3, 0.0, 0.3, 0.6)
"""Positions of the far map's points, m: ground beyond the height map, as far as images reach. VP
learns to predict it so that it remembers it; nothing reads the prediction."""
FAR_MAP_SIZE = len(FAR_MAP_X) * len(FAR_MAP_Y)
MAP_HEIGHT = 0.3
"""Height of the base above ground that is zero in the height map, m (Extreme Parkour)."""
NUM_FEET = len(LEGS)


def control_steps(seconds: float) -> int:
    """Return the number of control steps in a time, rounded."""
    return round(seconds / CONTROL_DT)


def proprioception_slices() -> dict[str, slice]:
    """Return the slice of each term of `PROPRIOCEPTION` in the vector, by name."""
    slices = {}
    start = 0
    for term in PROPRIOCEPTION:
        slices[term.name] = slice(start, start + term.size)
        start += term.size
    return slices
