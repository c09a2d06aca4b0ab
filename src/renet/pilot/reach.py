"""Distance from robots to the end of the ground that they have seen.

Images show the ground up to some distance ahead. Without them a robot walks towards the end of the
ground that VP remembers. Its motion since its last image tells the distance to that end. The ground
beyond is unknown.
"""

from typing import get_args

import numpy as np

from renet.interface import CONTROL_DT, HEIGHT_MAP_X, HEIGHT_MAP_Y, Told, Unseen

UNSEEN = get_args(Unseen)
DISTANCE = max(HEIGHT_MAP_X)
"""Distance ahead of the base up to which VP remembers an image, m; the map on which VP is trained
ends there."""
STOPPING_MARGIN = 0.5
"""Distance ahead of the base within which the ground must have been seen, m. The front feet are a
quarter of a metre ahead, and a robot needs as much to stop."""
OBSTACLE_END = 3.0
"""Distance beyond the end of the ground seen at which a robot stops on any ground, m: as far as the
longest stairs of training go."""
HALF_WIDTH = max(HEIGHT_MAP_Y)
"""Distance to the left and to the right up to which VP remembers an image, m."""
MAP_POINTS = np.array([(x, y) for x in HEIGHT_MAP_X for y in HEIGHT_MAP_Y])
"""Points of the height map in the base frame, [132, 2] m."""

_BETWEEN_FEET = (np.abs(MAP_POINTS[:, 1]) <= 0.15) & (MAP_POINTS[:, 0] >= -0.3)
UNDER_FEET = np.flatnonzero(_BETWEEN_FEET & (MAP_POINTS[:, 0] <= 0.15))
"""Points of the height map under a robot that stands, indices."""
STOPPING_GROUND = np.flatnonzero(_BETWEEN_FEET & (MAP_POINTS[:, 0] <= STOPPING_MARGIN))
"""Points of the height map under a robot and on its way until it stands, indices."""
LARGEST_RELIEF = 0.15
"""Largest difference of heights on ground on which robots stop, m."""
SPEEDS = {"walk": np.inf, "slow": 0.3, "stop": 0.0}
"""Largest speed towards unseen ground, m/s, by conduct."""


class Reach:
    """Motion of N robots since their last images, and the ground ahead that they have seen.

    Each robot's last image defines a frame: that of its base at this moment, with x ahead. The
    ground up to `DISTANCE` ahead and up to `HALF_WIDTH` to the sides has been seen, and so has the
    ground behind, from where the robot came.
    """

    def __init__(self, num_robots: int) -> None:
        """Initialize the motion at images of all robots."""
        self._position = np.zeros((num_robots, 2))
        self._yaw = np.zeros(num_robots)
        self.seen = np.ones(num_robots, bool)
        """False for robots that have seen no ground at all, [N] bool."""

    def reset(self, mask: np.ndarray) -> None:
        """Begin at a new image for the masked robots, [N] bool."""
        self._position[mask] = 0.0
        self._yaw[mask] = 0.0
        self.seen[mask] = True

    def forget(self, mask: np.ndarray) -> None:
        """Let the masked robots, [N] bool, have seen no ground until they have an image."""
        self.seen[mask] = False

    def move(self, velocity: np.ndarray, turn_rate: np.ndarray) -> None:
        """Advance the motion by one control step.

        Args:
            velocity: Velocities (x, y) of the bases in their own frames, [N, 2] m/s.
            turn_rate: Turn rates around the bases' z axes, [N] rad/s.
        """
        self._position += CONTROL_DT * _rotated(velocity, self._yaw)
        self._yaw += CONTROL_DT * turn_rate

    def ahead(self, direction: np.ndarray) -> np.ndarray:
        """Compute the distance from the bases to the end of the ground that was seen, [N] m.

        Args:
            direction: Unit vectors in the bases' frames, [N, 2]. For the zero vector the distance
                is infinite. In any other direction it is -inf for a robot that has seen no ground.
        """
        way = _rotated(direction, self._yaw)
        to_end = _distance(DISTANCE - self._position[:, 0], way[:, 0])
        to_left = _distance(HALF_WIDTH - self._position[:, 1], way[:, 1])
        to_right = _distance(HALF_WIDTH + self._position[:, 1], -way[:, 1])
        # Behind the frame's origin there are no sides: the robot walks back on its own track.
        behind = self._position[:, 0] + STOPPING_MARGIN * way[:, 0] < 0.0
        sideways = np.where(behind, np.inf, np.minimum(to_left, to_right))
        ahead = np.minimum(to_end, sideways)
        return np.where(self.seen | ~direction.any(axis=1), ahead, -np.inf)

    def covers(self, points: np.ndarray) -> np.ndarray:
        """Return a mask of points on ground that was seen, [N, K] bool.

        Args:
            points: Points in the bases' frames, the same for all robots, [K, 2] m.
        """
        place = self._position[:, None] + _rotated(points, self._yaw[:, None])
        ahead, left = np.moveaxis(place, -1, 0)
        # At the moment of the image its outermost points count, whatever the rounding.
        margin = 1e-9
        beside = (np.abs(left) <= HALF_WIDTH + margin) | (ahead < 0.0)
        return (ahead <= DISTANCE + margin) & beside & self.seen[:, None]


def can_stop(ahead: np.ndarray, height_map: np.ndarray) -> np.ndarray:
    """Return a mask of robots that are at the end of the ground seen and can stop there, [N] bool.

    A robot on an obstacle that it remembers, or in front of one, finishes the obstacle first.

    Args:
        ahead: Distance to the end of that ground, [N] m (see `Reach.ahead`).
        height_map: VP's map of the ground around the bases, [N, 132] m.
    """
    # Beyond that end VP only imagines what is ahead.
    level = np.where(
        ahead < 0.0,
        stands_on_level_ground(height_map),
        _is_level(height_map, STOPPING_GROUND),
    )
    return (ahead < STOPPING_MARGIN) & (level | (ahead < -OBSTACLE_END))


def stands_on_level_ground(height_map: np.ndarray) -> np.ndarray:
    """Return a mask of robots below which VP's maps, [N, 132] m, are level, [N] bool."""
    return _is_level(height_map, UNDER_FEET)


def _is_level(height_map: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return a mask of robots on whose maps, [N, 132] m, the points are level, [N] bool."""
    return np.ptp(height_map[:, points], axis=1) < LARGEST_RELIEF


def direction_of(command: np.ndarray, told: Told) -> np.ndarray:
    """Return the directions of commands [N, 3] in the base frame, unit vectors [N, 2].

    The vector is zero for a command to stand.
    """
    velocity = command[:, :2].copy()
    if told == "heading":
        # Only the first number is a velocity; the others are a heading, to which the robot turns.
        velocity[:, 1] = 0.0
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    return np.divide(velocity, speed, out=np.zeros_like(velocity), where=speed > 0.0)


def slowed(command: np.ndarray, told: Told, limit: np.ndarray) -> np.ndarray:
    """Limit the speed of commands.

    Args:
        command: Commands, [N, 3].
        told: Form of the commands.
        limit: Largest speeds, [N] m/s.

    Returns:
        Commands of the same directions and turns, [N, 3].
    """
    slow = command.copy()
    parts = slice(0, 1) if told == "heading" else slice(0, 2)
    speed = np.linalg.norm(command[:, parts], axis=1)
    share = np.divide(limit, speed, out=np.ones_like(speed), where=speed > limit)
    slow[:, parts] *= share[:, None]
    return slow


def _rotated(vector: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rotate vectors [..., 2] counterclockwise by angles [...] rad; shapes are broadcast."""
    cos = np.cos(angle)
    sin = np.sin(angle)
    x, y = np.moveaxis(vector, -1, 0)
    return np.stack((cos * x - sin * y, sin * x + cos * y), axis=-1)


def _distance(gap: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Compute the distance to a line along directions that need not be normal to it, [N] m.

    Args:
        gap: Distance to the line along its normal, [N] m.
        share: Cosine of the angle between direction and normal, [N]. Where it is not positive, the
            direction never meets the line and the distance is infinite.
    """
    approaches = share > 1e-6
    return np.divide(gap, share, out=np.full_like(gap, np.inf), where=approaches)
