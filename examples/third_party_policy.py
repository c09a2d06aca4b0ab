"""Study a policy that is not renet's: `python examples/third_party_policy.py policy.onnx`.

`renet evaluate benchmark --policy FILE --adapter NAME` enters one in the fault benchmark.
"""

import hashlib
import sys
from pathlib import Path

import numpy as np
import onnxruntime as ort
import tyro

from renet.errors import RenetError, reason
from renet.evaluation.adapters.models import demand_shapes
from renet.evaluation.evaluator import Evaluator, Provenance
from renet.evaluation.studies.faults import FaultStudy
from renet.terminal import show

SHAPES = {"observation": (45,), "depth": (48, 64), "action": (12,)}  # Of each robot.


def open_model(model: Path) -> ort.InferenceSession:
    """Open an ONNX model; raises RenetError for a file that is none."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1  # Several would spin between operations.
    options.log_severity_level = 4  # What is wrong with a model, the exception says.
    try:
        return ort.InferenceSession(model, options)
    except Exception as error:  # ONNX Runtime's have no base class of their own.
        line = str(error).splitlines()[0]
        raise RenetError(f"{model} is no ONNX model: {line}; export yours as one") from None


class TheirPolicy:
    """An ONNX model (observation [N, 45], depth [N, 48, 64]) -> action [N, 12], without memory."""

    def __init__(self, model: Path, num_robots: int):
        self.model = open_model(model)
        demand_shapes(model, [*self.model.get_inputs(), *self.model.get_outputs()], SHAPES)
        self.anomaly_score = np.zeros(num_robots)  # Constant: only the other monitors judge images.

    def reset(self, mask=None): ...

    def step(self, proprioception, depth, op_mask):
        empty = op_mask[:, None, None]  # Without its camera the policy sees that all is far.
        depth = np.where(empty, 1.0, depth).astype(np.float32)
        return self.model.run(["action"], {"observation": proprioception, "depth": depth})[0]


class TheirEvaluator(Evaluator):
    def __init__(self, model: Path, conditions="training", motors="ideal"):
        super().__init__(conditions=conditions, motors=motors)
        try:
            digest = hashlib.sha256(model.read_bytes()).hexdigest()
        except OSError as error:
            raise RenetError(f"cannot read {model}: {reason(error)}; name an ONNX file") from None
        self.make_policy = lambda num_robots: TheirPolicy(model, num_robots)
        self.provenance = lambda seed: Provenance(model.stem, digest, "native", seed)


def main(model: tyro.conf.Positional[Path], results: Path = Path("results")) -> None:
    """Look at single faults with an ONNX policy, and print who crosses."""
    evaluator = TheirEvaluator(model)
    evaluator.make_policy(1)  # What is no such model is refused before a file is written.
    study = FaultStudy(out=results / model.stem, quick=True)
    summary = study.run(evaluator)
    for title, header, rows in study.tables(summary):
        show(title, header, rows)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except RenetError as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from error
