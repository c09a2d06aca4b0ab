"""Every study with hardly anything in it, and the stand-ins for a simulator it is run with."""

from collections.abc import Callable
from functools import partial

import numpy as np

from renet.evaluation.studies.camera_use import CameraUseStudy
from renet.evaluation.studies.faults import FaultStudy
from renet.evaluation.studies.margins import MarginsStudy
from renet.evaluation.studies.memory import MemoryStudy
from renet.evaluation.studies.noise import NoiseStudy
from renet.evaluation.studies.standing import StandingStudy
from renet.evaluation.studies.terrain import SuccessStudy, TerrainStudy
from renet.evaluation.study import Study
from renet.terrain.tiles import tiles

from .fakes import FakeEnv, FakeEvaluator


class Ladder(FakeEnv):
    """Robots leave their tile after 20 steps up to a level of their kind.

    Above it they fall, two levels higher they stand.
    """

    reach = np.array([{"stairs_up": 10, "stairs_down": 3, "gap": 2}.get(k, 4) for k in tiles()])
    able: np.ndarray | None = None
    """Who can; None on flat ground, which nobody leaves."""
    stands: np.ndarray | bool = False
    """Who neither leaves its tile nor falls."""

    def place(self, levels: np.ndarray, kinds: np.ndarray) -> None:
        self.able, self.stands = levels < self.reach[kinds], levels >= self.reach[kinds] + 2

    def step(self, action: np.ndarray):
        result = super().step(action)
        if self.able is None:
            result.fell[0] = result.ended[0] = True
            return result
        result.ended[:] = (self.clock % 20 == 0) & ~np.asarray(self.stands)
        result.fell[:] = result.ended & ~self.able
        return result


class Hurdles(Ladder):
    """A second try would succeed, and must not count."""

    def step(self, action: np.ndarray):
        result = super().step(action)
        if self.clock >= 20:
            self.able = ~np.zeros(self.num_robots, bool)
        return result


class HurdlesEvaluator(FakeEvaluator):
    def make_env(self, task, robots, speed, seed):
        yaw = task.events["spawn"].params["pose_range"]["yaw"]
        assert -0.2 < yaw[0] < yaw[1] < 0.2
        return Hurdles(len(robots))


class Obedient(FakeEnv):
    """Stops on command; robots of uneven number sway their only joint for ever."""

    speed = 0.6

    def place(self, levels: np.ndarray, kinds: np.ndarray) -> None:
        """One ground is as good as another."""

    def command(self, speed: float) -> None:
        self.speed = speed

    def step(self, action: np.ndarray):
        before = self.x.copy()
        result = super().step(action)
        self.x = before + self.speed * 0.02
        return result

    def poses(self, rows) -> np.ndarray:
        pose = np.zeros((len(rows), 8))
        pose[:, 0] = self.x[list(rows)]
        pose[1::2, 7] = 0.1 * (self.clock % 2)
        return pose


CLASSES = (
    NoiseStudy,
    FaultStudy,
    MemoryStudy,
    CameraUseStudy,
    SuccessStudy,
    TerrainStudy,
    StandingStudy,
    MarginsStudy,
)
STUDIES: dict[str, type[Study]] = {study.name: study for study in CLASSES}
SETTINGS: dict[str, dict] = {
    "noise": {"robots": 2, "onsets": (1.0,), "lasts": 4.0, "seconds": 5.0},
    "faults": {"faults": ("gaussian", "frozen"), "grounds": ("flat", "gap"), "severities": (1, 5)}
    | {"robots": 2, "lasts": 1.0, "seconds": 2.6, "healthy_minutes": 0.1},
    "memory": {"grounds": ("gap:3", "platform:4"), "robots": 2, "seconds": 4},
    "camera_use": {"grounds": ("gap:3",), "robots": 2, "seconds": 1.0},
    "success": {"kinds": ("gap", "stairs_up"), "levels": (1, 3, 5), "robots": 3, "seconds": 2},
    "terrain": {"robots": 3, "seconds": 2},
    "standing": {"kinds": ("flat", "stairs_up"), "robots": 2, "seconds": 1.0},
    "margins": {"axes": ("payload",), "robots": 1, "seconds": 0.2},
}
TINY = {name: STUDIES[name](**settings) for name, settings in SETTINGS.items()}
EVALUATORS: dict[str, Callable[[], FakeEvaluator]] = {
    "success": HurdlesEvaluator,
    "terrain": partial(FakeEvaluator, Ladder),
    "standing": partial(FakeEvaluator, Obedient),
}
"""Those of the other studies are a `FakeEvaluator`."""
