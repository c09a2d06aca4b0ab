"""An evaluator without physics: robots that walk unless a spoilt image drives them."""

from collections.abc import Sequence
from typing import ClassVar

import mujoco
import numpy as np

from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import Provenance
from renet.evaluation.rollout import Rollout, Trial, pilot_modes
from renet.evaluation.trace import StepResult
from renet.interface import ACTION_SIZE, DEPTH_SHAPE, PROPRIOCEPTION_SIZE
from renet.pilot import Pilot
from renet.selector import SelectorSpec, make_selector
from renet.tasks import VISUAL_GO1

GROUND = np.full(DEPTH_SHAPE, 0.5, np.float32)
SPEED = 0.62
SCENE = """<mujoco><worldbody><light pos="0 0 3"/><geom type="plane" size="0 0 1"/>
<body><freejoint/><geom type="box" size="0.2 0.1 0.1"/></body></worldbody></mujoco>"""


class FakeEnv:
    """Speed falls with the first action; a robot driven at 1 falls after ten steps and restarts."""

    def __init__(self, num_robots: int) -> None:
        self.num_robots = num_robots
        self.bad, self.clock = np.zeros(num_robots, int), 0
        self.x = np.zeros(num_robots)
        self.scene_spec = mujoco.MjSpec.from_string(SCENE)

    def reset(self) -> StepResult:
        self.clock = 0
        self.x[:] = 0
        return self.result(np.zeros(self.num_robots), np.zeros(self.num_robots, bool))

    def step(self, action: np.ndarray) -> StepResult:
        self.clock += 1
        harm = action[:, 0]
        self.bad = np.where(harm >= 1, self.bad + 1, 0)
        fell = self.bad > 10
        self.bad[fell] = 0
        self.x += SPEED * 0.02
        self.x[fell] = 0
        return self.result(SPEED * (1 - np.minimum(harm, 1)), fell)

    def perturb_cameras(self, view) -> None:
        """Its cameras see one ground, whatever the scene."""

    def place_on(self, grounds: Sequence[str]) -> None:
        assert len(grounds) == self.num_robots

    def poses(self, rows: Sequence[int]) -> np.ndarray:
        pose = np.zeros((len(rows), 7))
        pose[:, 0], pose[:, 2], pose[:, 3] = self.x[list(rows)], 0.2, 1
        return pose

    def result(self, speed: np.ndarray, fell: np.ndarray) -> StepResult:
        n = self.num_robots
        return StepResult(
            proprioception=np.zeros((n, PROPRIOCEPTION_SIZE), np.float32),
            depth=np.tile(GROUND, (n, 1, 1)).astype(np.float16),
            angular_velocity=np.zeros((n, 3), np.float32),
            forward_velocity=speed,
            travelled=self.x.copy(),
            collisions=np.zeros(n),
            power=np.full(n, 60.0),
            fell=fell,
            ended=fell.copy(),
        )


class FakePolicy:
    """Scores an image by its distance from the ground; VP acts as badly as its image is."""

    def __init__(self, num_robots: int) -> None:
        self.anomaly_score = np.zeros(num_robots)
        self.resets: list[np.ndarray] = []

    def reset(self, mask: np.ndarray | None = None) -> None:
        if mask is not None:
            self.resets.append(mask.copy())

    def step(self, proprioception, depth, op_mask) -> np.ndarray:
        self.anomaly_score = np.square(depth - GROUND).mean(axis=(1, 2)) + 1e-4
        action = np.zeros((len(depth), ACTION_SIZE), np.float32)
        action[:, 0] = np.where(op_mask, 0.0, 10 * (self.anomaly_score - 1e-4))
        return action


def fake_rollout(env: FakeEnv, policy: FakePolicy, trials: Sequence[Trial], **selectors) -> Rollout:
    """A run of a fake policy whose robots obey selectors, by their mode."""
    return Rollout(env, Pilot(policy, selectors, pilot_modes(trials)), trials, 0)


class FakeEvaluator:
    """Stands in for `renet.evaluation.evaluator.Evaluator`; its robots and policy are fakes."""

    beta = paper_beta = 0.01
    thresholds: ClassVar = {"reconstruction": 0.01, "duplicate": 3.0, "frame_age": 0.2}
    robot = VISUAL_GO1
    rollout = Evaluator.rollout
    terrain_env_cfg = Evaluator.terrain_env_cfg
    set_conditions = Evaluator.set_conditions
    conditions = "nominal"
    training_sha256 = "0" * 64

    def __init__(self, env: type[FakeEnv] = FakeEnv, policy: type[FakePolicy] = FakePolicy) -> None:
        self.env, self.policy = env, policy

    def provenance(self, seed: int) -> Provenance:
        return Provenance("fake", "0" * 64, "native", seed)

    def make_env(self, task, robots: Sequence[int], speed: float, seed: int) -> FakeEnv:
        return self.env(len(robots))

    def make_policy(self, num_robots: int) -> FakePolicy:
        return self.policy(num_robots)

    def make_selector(self, kind: str, num_robots: int):
        return make_selector("switch", SelectorSpec(beta=self.beta), num_robots)
