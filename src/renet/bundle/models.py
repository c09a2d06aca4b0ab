"""The three ONNX models of a bundle: their inputs and outputs, and the checks before they run.

A model is a program. `graph.py` refuses loops, branches and sizes that depend on values; the rest
is run in a process of its own, with limits, before this process loads it.
"""

import hashlib
import json
import math
import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime as ort

from renet.bundle.blocks import Session
from renet.bundle.graph import check_graph
from renet.errors import RenetError
from renet.files import MEGABYTE, read_bytes
from renet.interface import (
    ACTION_SIZE,
    DEPTH_SHAPE,
    FRAMES,
    HEIGHT_MAP_SIZE,
    LATENT,
    NUM_FEET,
    PROPRIOCEPTION_SIZE,
)
from renet.trial import judge, run_trial

MODELS = ("actor", "estimator", "vision")
MAX_MODEL = 32 * MEGABYTE
"""Largest size of one model, bytes; the shipped three have 2 MB together."""
MAX_RUN = 0.2
"""Processor time in seconds of one run for one robot; the shipped ones need a few milliseconds."""
VARIANCE = "variance_score"
"""Output [N] of vision models that predict the variance of their own error."""
MAP_ERROR = "map_error"
"""Output [N] of estimators that predict the error of their height map ahead, m."""
HAS_IMAGE = "has_image"
"""Input [N, 1] of estimators that can do without an image: 1 where there is one, 0 where not."""
_accepted: set[str] = set()


def model_shapes(history: int) -> dict[str, tuple[dict, dict]]:
    """Inputs and outputs of each model by name, without the batch axis."""
    depth, observation = (FRAMES, *DEPTH_SHAPE), (PROPRIOCEPTION_SIZE,)
    latents = {"latent_op": (LATENT,), "latent_vp": (LATENT,)}
    estimates = {f"next_{name}": shape for name, shape in latents.items()}
    estimates |= {"velocity_op": (3,), "velocity_vp": (3,), "feet_height": (NUM_FEET,)}
    estimates["height_map"] = (HEIGHT_MAP_SIZE,)
    history_and_depth = {"proprioception_history": (history, *observation), "depth": depth}
    return {
        "actor": (
            {"proprioception": observation, **latents, "op_mask": (1,)},
            {"action": (ACTION_SIZE,)},
        ),
        "estimator": (history_and_depth | latents, estimates),
        "vision": ({"depth": depth}, {"reconstruction": depth, "anomaly_score": ()}),
    }


def read_model(path: Path, sha256: str | None) -> bytes:
    """A model's bytes; raises RenetError unless they are the ones its manifest describes."""
    data = read_bytes(path, MAX_MODEL, "model")
    if hashlib.sha256(data).hexdigest() != sha256:
        raise RenetError(
            f"{path} is not the file the manifest describes (sha256 differs): export the bundle "
            "anew or fetch it again"
        )
    return data


def try_models(models: dict[str, bytes], history: int, where: str) -> None:
    """Run models once, both masks, in a process of its own; models that passed are remembered.

    Args:
        models: ONNX bytes by name, in the order of `MODELS`.
        history: proprioceptions that the estimator sees. where: the bundle, for messages.

    Raises:
        RenetError: one of them cannot run, needs too much time or memory, or has outputs of
            another shape or type, or that are not finite.
    """
    digest = hashlib.sha256(b"".join([str(history).encode(), *models.values()])).hexdigest()
    if digest in _accepted:
        return
    sizes = json.dumps([history, {name: len(data) for name, data in models.items()}])
    run_trial("renet.bundle.models", [sizes], where, b"".join(models.values()))
    _accepted.add(digest)


def session(data: bytes) -> ort.InferenceSession:
    """A model ready to run on one thread of the CPU; several would spin between operations."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    options.add_session_config_entry("session.load_model_format", "ONNX")
    return ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])


def remembers(estimator: Session) -> bool:
    """Whether an estimator can do without an image; those of before schema 2 cannot."""
    return HAS_IMAGE in {node.name for node in estimator.get_inputs()}


def problem(model: ort.InferenceSession, name: str, history: int) -> str:
    """What is wrong with a model's signature or with what it computes; empty if nothing is."""
    inputs, outputs = model_shapes(history)[name]
    if name == "estimator" and remembers(model):
        inputs = inputs | {HAS_IMAGE: (1,)}
    expected = {key: f"tensor(float) {shape} per robot" for key, shape in inputs.items()}
    actual = {n.name: f"{n.type} {tuple(n.shape[1:])} per robot" for n in model.get_inputs()}
    for key in expected | actual:
        if actual.get(key) != expected.get(key):
            return (
                f"{name}.onnx: input {key!r} is {actual.get(key, 'absent')}, "
                f"expected {expected.get(key, 'absent')}"
            )
    names = [node.name for node in model.get_outputs()]
    optional = {VARIANCE: (), MAP_ERROR: ()}
    outputs = outputs | {key: shape for key, shape in optional.items() if key in names}
    fastest = math.inf
    for mask in (0.0, 1.0):
        feed = {key: np.full((1, *shape), 0.5, np.float32) for key, shape in inputs.items()}
        for flag in feed.keys() & {"op_mask", HAS_IMAGE}:
            feed[flag][:] = mask
        start = time.process_time()
        values = dict(zip(names, map(np.asarray, model.run(None, feed)), strict=True))
        fastest = min(fastest, time.process_time() - start)
        for key, shape in outputs.items():
            if key not in values:
                return f"{name}.onnx has no output {key!r}: wrong architecture"
            value = values[key]
            if value.shape != (1, *shape) or value.dtype != np.float32:
                return (
                    f"{name}.onnx gives {key!r} of {value.dtype} {value.shape}, expected "
                    f"float32 {(1, *shape)}"
                )
            if not np.isfinite(value).all():
                return f"{name}.onnx gives {key!r} that is not finite"
    if fastest > MAX_RUN:
        return f"{name}.onnx needs {fastest:.1f} s of processor time a run, more than {MAX_RUN:g} s"
    return ""


def _trial() -> str:
    history, sizes = json.loads(sys.argv[1])
    for name, size in sizes.items():
        data = sys.stdin.buffer.read(size)
        try:
            check_graph(data)
            verdict = problem(session(data), name, history)
        except ValueError as error:
            verdict = f"{name}.onnx is refused: {error}"
        except Exception as error:  # ONNX Runtime raises its own unrelated types.
            reason = " ".join(str(error).split())[:300] or type(error).__name__
            if "alloc" in reason:
                raise MemoryError from error
            verdict = f"{name}.onnx is not a model ONNX Runtime can run: {reason}"
        if verdict:
            return verdict
    return ""


if __name__ == "__main__":
    judge(_trial)
