"""One more fault: `python examples/add_fault.py deploy --camera sim --fault fog:4@5s`."""

from __future__ import annotations

import numpy as np

from renet.cli import main
from renet.faults import FAULTS
from renet.faults.base import ImageFault


class Fog(ImageFault):
    """Distant surfaces look nearer, as fog scatters light back; level is by how much."""

    unit = "share"
    levels = (0.1, 0.3, 0.5, 0.7, 0.9)

    def spoil(self, image: np.ndarray, robot: int, elapsed: float) -> np.ndarray:
        """The image [48, 64], 0 near to 1 far, with a little noise of the robot's own."""
        noise = self.rngs[robot].normal(0.0, 0.02, image.shape)
        return image * (1.0 - self.level * image) + noise * self.level


FAULTS[Fog.name] = Fog  # Now every command, study and figure offers it.

if __name__ == "__main__":
    raise SystemExit(main())
