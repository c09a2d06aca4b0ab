"""Whether MuJoCo Playground's Go1 policy uses its camera: it sees no image.

`python examples/playground_policy.py evaluate playground --model go1_policy.onnx` says so; the
model is mujoco_playground/experimental/sim2sim/onnx/go1_policy.onnx of Playground's repository.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from renet.cli import COMMANDS, Command, main
from renet.errors import RenetError
from renet.evaluation.studies.camera_use import CameraUseStudy
from renet.interface import PROPRIOCEPTION, proprioception_slices
from third_party_policy import TheirEvaluator, open_model

SLICES = proprioception_slices()


class PlaygroundPolicy:
    """The model, fed with the simulator's base velocity, which no robot measures."""

    def __init__(self, model: Path, num_robots: int, evaluator: TheirEvaluator):
        self.model = open_model(model)
        self.evaluator = evaluator
        if self.model.get_inputs()[0].shape != [1, 48]:
            raise RenetError(f"{model} is not Playground's Go1 policy: that takes obs [1, 48]")
        self.action = np.zeros((num_robots, 12), np.float32)
        self.anomaly_score = np.zeros(num_robots)

    def reset(self, mask=None):
        self.action[slice(None) if mask is None else mask] = 0.0

    def step(self, proprioception, depth, op_mask):
        part = {t.name: proprioception[:, SLICES[t.name]] / t.scale for t in PROPRIOCEPTION}
        speed, sine, _ = part.pop("command").T
        part["last_action"] = self.action
        command = np.stack((speed, np.zeros_like(speed), 2.0 * sine), axis=1)  # Steer ahead.
        observation = (self.evaluator.env.observation["velocity"].numpy(), *part.values(), command)
        rows = np.concatenate(observation, axis=1, dtype=np.float32)[:, None]
        self.action = np.concatenate([self.model.run(None, {"obs": row})[0] for row in rows])
        return 2.0 * self.action  # Their scale is 0.5, the harness's 0.25; both add to one pose.


class Playground:
    def make_evaluator(self):
        evaluator = TheirEvaluator(self.model, self.conditions, self.motors)
        evaluator.privileged = ("velocity",)
        evaluator.make_policy = lambda n: PlaygroundPolicy(self.model, n, evaluator)
        return evaluator


@dataclass(frozen=True)
class CameraUse(Playground, CameraUseStudy):
    """Whether Playground's Go1 policy uses its camera."""

    model: Path = Path("go1_policy.onnx")


if __name__ == "__main__":
    words = f"{__name__}:CameraUse:CameraUse.main"
    COMMANDS["evaluate playground"] = Command(CameraUse.__doc__, words)
    raise SystemExit(main())
