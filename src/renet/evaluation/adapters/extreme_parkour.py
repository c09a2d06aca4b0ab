"""Extreme Parkour (Cheng et al. 2023), which reads depth images, on the Go2.

The source is github.com/chengxuxin/extreme-parkour; its save_jit.py leaves two files, base_jit.pt
and vision_weight.pt, which examples/extreme_parkour_file.py joins to one. Weights for the Go2 are
in the folder traced of github.com/change-every/Extreme-Parkour-Onboard.

Two things are not as in the source. The policy predicts headings of its own; here it is told the
benchmark's, as its teacher is told those of its goals. And it sees what renet's Go2 sees, whose
camera looks 23 degrees down, where the config.json of those weights says 0 to 1 degree, and whose
image is 66 degrees wide in place of 87: beyond it the depth of its border is repeated.
"""

import numpy as np

from renet.camera import Intrinsics
from renet.evaluation.adapters import base
from renet.evaluation.adapters.models import Model
from renet.interface import DEPTH_RANGE, DEPTH_SHAPE, TURN_GAIN

_PROPRIOCEPTION = 53
"""Size of an observation of the robot itself."""
_HEADINGS = slice(6, 8)
"""Place in it of the angles to this heading and to the next one, which encoder and history lack."""
_HISTORY = 10
"""Number of earlier observations in the actor's input, oldest first."""
_UNREAD = 132 + 9 + 29
"""Numbers between observation and history: scans of the ground, the base's velocity and physical
parameters. The first and the last are of training alone, the file itself estimates the others."""
_STATE = 512
"""Size of the encoder's GRU."""
_LATENT = 32
"""Size of the encoder's output, without the headings that it predicts."""
_STEPS_PER_IMAGE = 5
"""Control steps from one run of the encoder to the next."""
_LARGEST_ACTION = 1.2
"""Largest distance of a joint target from the pose, rad."""
_CAMERA_VIEW = np.radians(87.0)
"""Angle that the policy's camera sees from left to right, rad."""


def _weights(places: np.ndarray, size: int) -> np.ndarray:
    """Interpolate `size` values linearly at places, in units of them: weights [places, size].

    Beyond the first and the last value these are repeated.
    """
    unit_vectors = np.eye(size)
    return np.stack([np.interp(places, np.arange(size), unit) for unit in unit_vectors], axis=1)


def _image_places() -> tuple[np.ndarray, np.ndarray]:
    """Return the rows [58] and columns [87] of our image, in pixels, that the policy's pixels show.

    Its camera has 60 by 106 square pixels, of which the lowest two rows and four columns at either
    side are cut off, before the columns that are left are resized to 87.
    """
    # Offsets of the pixels' centres from the image's, at a distance of 1 m.
    pixel = np.tan(_CAMERA_VIEW / 2) / 53
    down = (np.arange(58) + 0.5 - 30) * pixel
    right = ((np.arange(87) + 0.5) * 98 / 87 - 49) * pixel
    lens = Intrinsics()
    return lens.cy + lens.fy * down - 0.5, lens.cx + lens.fx * right - 0.5


class Adapter(base.OffsetAdapter):
    """Policy with a history, and an encoder of images whose state it keeps for each robot.

    The file is TorchScript with two methods: `encode` turns images [K, 58, 87], observations
    [K, 53] and states [K, 512] into latents [K, 34] and states; `forward` turns the actor's inputs
    [N, 753] and latents [N, 32] into actions [N, 12].
    """

    bundle = "go2-parkour"
    stiffness = 40.0
    damping = 1.0
    uses_camera = True
    needs_feet_contact = True
    # Joints and feet are in renet's own order.
    pose = np.array((-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5), np.float32)
    action_scale = 0.25

    def __init__(self, model: Model, num_robots: int) -> None:
        super().__init__(model, num_robots)
        self._history = np.zeros((num_robots, _HISTORY, _PROPRIOCEPTION), np.float32)
        self._state = np.zeros((num_robots, _STATE), np.float32)
        self._latent = np.zeros((num_robots, _LATENT), np.float32)
        self._contact = np.zeros((num_robots, 4), bool)
        """Feet on the ground in the last step, [N, 4]."""
        self._age = np.zeros(num_robots, int)
        """Control steps since each robot's episode began, [N]."""
        rows, columns = _image_places()
        self._row_weights = _weights(rows, DEPTH_SHAPE[0])
        self._column_weights = _weights(columns, DEPTH_SHAPE[1])

    def reset(self, mask: np.ndarray) -> None:
        """Clear all that is kept of the masked robots, [N] bool."""
        super().reset(mask)
        for kept in (self._history, self._state, self._latent, self._contact, self._age):
            kept[mask] = 0

    def act(self, senses: base.Senses) -> np.ndarray:
        """Return joint targets, [N, 12] rad."""
        observation = self._observe(senses)
        due = np.flatnonzero(self._age % _STEPS_PER_IMAGE == 0)
        if len(due):
            image = self._image(senses.depth[due])
            inputs = image, observation[due], self._state[due]
            latent, self._state[due] = self.model.run(*inputs, method="encode")[:2]
            self._latent[due] = latent[:, :_LATENT]
        # Only the actor reads the headings.
        own = observation.copy()
        own[:, _HEADINGS] = senses.command[:, 2:] / TURN_GAIN
        unread = np.zeros((self.num_robots, _UNREAD), np.float32)
        history = self._history.reshape(self.num_robots, -1)
        inputs = np.concatenate((own, unread, history), axis=1)
        self._action = self.model.run(inputs, self._latent)[0]
        self._remember(observation)
        largest = _LARGEST_ACTION / self.action_scale
        # The policy observes its action as it was before the limit.
        return self.pose + self.action_scale * self._action.clip(-largest, largest)

    def _observe(self, senses: base.Senses) -> np.ndarray:
        """Observe the robot itself, with headings of zero, [N, 53]."""
        x, y, z = senses.gravity.T
        roll = np.arctan2(-y, -z)
        pitch = np.arcsin(np.clip(x, -1.0, 1.0))
        # A foot counts as on the ground if it was there a step before.
        contact = senses.feet_contact | self._contact
        self._contact = senses.feet_contact
        count = self.num_robots
        parts = (
            senses.angular_velocity * 0.25,
            np.stack((roll, pitch), axis=1),
            # A slot that is always zero, the headings, and speeds sideways and in turning.
            np.zeros((count, 5)),
            senses.command[:, :1],
            # One-hot: obstacles, not flat ground.
            np.tile((1.0, 0.0), (count, 1)),
            senses.joint_position - self.pose,
            senses.joint_velocity * 0.05,
            self._action,
            contact - 0.5,
        )
        return np.concatenate(parts, axis=1).astype(np.float32)

    def _image(self, depth: np.ndarray) -> np.ndarray:
        """Convert our images, [K, 48, 64] m, to the policy's, [K, 58, 87] from -0.5 to 0.5."""
        image = self._row_weights @ depth @ self._column_weights.T
        return (image / DEPTH_RANGE - 0.5).astype(np.float32)

    def _remember(self, observation: np.ndarray) -> None:
        """Add observations, [N, 53], to the history; an episode's first two fill all of it."""
        self._history[:, :-1] = self._history[:, 1:].copy()
        self._history[:, -1] = observation
        fresh = self._age <= 1
        self._history[fresh] = observation[fresh, None]
        self._age += 1
