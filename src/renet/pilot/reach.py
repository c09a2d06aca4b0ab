"""The end of the ground that a robot has seen, and its walk towards it.

Images show the ground up to some distance ahead. While they are withheld a robot walks towards the
end of what VP remembers; its own motion since its last image tells how far that is. Ground beyond
may hold anything.
"""

from typing import get_args

import numpy as np

from renet.interface import CONTROL_DT, HEIGHT_MAP_X, HEIGHT_MAP_Y, Told, Unseen

UNSEEN = get_args(Unseen)
DISTANCE = max(HEIGHT_MAP_X)
"""Distance ahead of the base up to which VP remembers an image, m: the map that teaches it ends
there."""
MARGIN = 0.5
"""Distance ahead of the base within which the ground must have been seen, m: the front feet are a
quarter of a metre ahead, and a robot needs as much to stop."""
BEYOND = 0.3
"""Distance beyond the end of what it has seen at which a robot has finished any obstacle that it
remembered, m."""
HALF_WIDTH = max(HEIGHT_MAP_Y)
"""Distance to either side of the way that VP remembers, m."""
FOOTPRINT = (
    [i for i, x in enumerate(HEIGHT_MAP_X) if abs(x) <= 0.3],
    [i for i, y in enumerate(HEIGHT_MAP_Y) if abs(y) <= 0.15],
)
"""Rows and columns of the height map under a robot and its next step."""
LEVEL = 0.15
"""Largest difference of heights within that footprint of ground to stop on, m."""
SPEEDS = {"walk": np.inf, "slow": 0.3, "stop": 0.0}
"""Fastest walk towards unseen ground, m/s."""


class Reach:
    """Motion of N robots since their last image, and how far they may go on.

    Each robot's last image defines a frame: its base at that moment, x ahead. The ground within
    `distance` ahead of that frame and `HALF_WIDTH` to its sides has been seen, and so has all
    behind it, for the robot came from there.
    """

    def __init__(self, num_robots: int, distance: float = DISTANCE) -> None:
        """Begin with an image of every robot.

        Args:
            num_robots: N.
            distance: Distance ahead of the base up to which an image is remembered, m.
        """
        self.distance = distance
        self._position = np.zeros((num_robots, 2))
        self._yaw = np.zeros(num_robots)

    def reset(self, mask: np.ndarray) -> None:
        """Let the masked robots [N] begin at a new image."""
        self._position[mask] = 0.0
        self._yaw[mask] = 0.0

    def move(self, velocity: np.ndarray, turn_rate: np.ndarray) -> None:
        """Let one control step pass.

        Args:
            velocity: Of the bases in their own frames, x and y, [N, 2] m/s.
            turn_rate: Around the bases' z axes, [N] rad/s.
        """
        self._position += CONTROL_DT * _rotated(velocity, self._yaw)
        self._yaw += CONTROL_DT * turn_rate

    def ahead(self, direction: np.ndarray) -> np.ndarray:
        """Distance from the bases to the end of the ground that was seen, [N] m.

        Args:
            direction: Unit vectors in the bases' frames, [N, 2]; the zero vector leads nowhere,
                infinitely far.
        """
        way = _rotated(direction, self._yaw)
        to_end = _distance(self.distance - self._position[:, 0], way[:, 0])
        to_left = _distance(HALF_WIDTH - self._position[:, 1], way[:, 1])
        to_right = _distance(HALF_WIDTH + self._position[:, 1], -way[:, 1])
        # Behind the image's frame the robot's own track is all that counts.
        behind = self._position[:, 0] + MARGIN * way[:, 0] < 0.0
        sideways = np.where(behind, np.inf, np.minimum(to_left, to_right))
        return np.minimum(to_end, sideways)


def can_stop(ahead: np.ndarray, height_map: np.ndarray) -> np.ndarray:
    """Whether robots are to heed the end of the ground that they have seen, [N] bool.

    A robot amid an obstacle that it remembers finishes it first.

    Args:
        ahead: Distance to the end of that ground, [N] m.
        height_map: VP's map of the ground around the bases, [N, 132] m, as `interface` has it.
    """
    return (ahead < MARGIN) & (_on_level_ground(height_map) | (ahead < -BEYOND))


def _on_level_ground(height_map: np.ndarray) -> np.ndarray:
    """Whether the remembered ground under robots and their next step is level, [N] bool."""
    grid = height_map.reshape(-1, len(HEIGHT_MAP_X), len(HEIGHT_MAP_Y))
    ground = grid[:, FOOTPRINT[0]][:, :, FOOTPRINT[1]].reshape(len(grid), -1)
    return np.ptp(ground, axis=1) < LEVEL


def direction_of(command: np.ndarray, told: Told) -> np.ndarray:
    """Unit vectors [N, 2] of the way that commands [N, 3] ask for, base frame; zero to stand."""
    velocity = command[:, :2].copy()
    if told == "heading":
        # The policy turns to its heading and walks ahead.
        velocity[:, 1] = 0.0
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    return np.divide(velocity, speed, out=np.zeros_like(velocity), where=speed > 0.0)


def slowed(command: np.ndarray, told: Told, limit: np.ndarray) -> np.ndarray:
    """Commands [N, 3] whose speed is at most `limit` [N], m/s; turns stay."""
    slow = command.copy()
    parts = slice(0, 1) if told == "heading" else slice(0, 2)
    speed = np.linalg.norm(command[:, parts], axis=1)
    share = np.divide(limit, speed, out=np.ones_like(speed), where=speed > limit)
    slow[:, parts] *= share[:, None]
    return slow


def _rotated(vector: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Vectors [N, 2] turned by angles [N], rad, counterclockwise."""
    cos = np.cos(angle)
    sin = np.sin(angle)
    x, y = vector.T
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=1)


def _distance(gap: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Length of ways that approach a line at a distance `gap` by `share` of each metre, [N] m."""
    approaches = share > 1e-6
    return np.divide(gap, share, out=np.full_like(gap, np.inf), where=approaches)
