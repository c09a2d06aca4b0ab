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
from textwrap import shorten

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
"""Names of a bundle's models."""
MAX_MODEL_BYTES = 32 * MEGABYTE
"""Largest size of one model, bytes; a shipped bundle's three have less than 3 MB together."""
MAX_RUN = 0.2
"""Most processor time of one run for one robot, s; the shipped models need a few milliseconds."""
VARIANCE = "variance_score"
"""Output [N] of vision models that predict the variance of their own error."""
SURPRISE = "surprise"
"""Output [N] of vision models that expect the next image: how much it contradicts that."""
STILLNESS = "stillness"
"""Output [N] of vision models that expect the next image: the share of the change that the robot's
motion should have brought to the last images, and which they lack."""
MAP_ERROR = "map_error"
"""Output [N] of estimators that predict the error of their height map ahead, m."""
HAS_IMAGE = "has_image"
"""Input [N, 1] of estimators that can do without an image: 1 where there is one, 0 where not."""
EVIDENCE = {"evidence": (2,)}
"""Further input of vision models with an output `STILLNESS`: the evidence of earlier images (see
`models.expectation.Evidence`)."""
NEXT_EVIDENCE = {"next_evidence": (2,)}
"""Further output of these models: the evidence with the newest image."""
_accepted: set[str] = set()
"""Digests of models that this process has tried."""


def model_shapes(history: int) -> dict[str, tuple[dict, dict]]:
    """Return the shapes of each model's inputs and outputs by name, without the batch axis.

    `history` is the number of proprioceptions that the estimator sees.
    """
    depth = (FRAMES, *DEPTH_SHAPE)
    observation = (PROPRIOCEPTION_SIZE,)
    latents = {"latent_op": (LATENT,), "latent_vp": (LATENT,)}
    estimates = {
        "next_latent_op": (LATENT,),
        "next_latent_vp": (LATENT,),
        "velocity_op": (3,),
        "velocity_vp": (3,),
        "feet_height": (NUM_FEET,),
        "height_map": (HEIGHT_MAP_SIZE,),
    }
    history_and_depth = {"proprioception_history": (history, *observation), "depth": depth}
    return {
        "actor": (
            {"proprioception": observation, **latents, "op_mask": (1,)},
            {"action": (ACTION_SIZE,)},
        ),
        "estimator": (history_and_depth | latents, estimates),
        "vision": ({"depth": depth}, {"reconstruction": depth, "anomaly_score": ()}),
    }


def recollection_shapes(history: int) -> dict[str, tuple[int, ...]]:
    """Return the inputs of vision models with an output `SURPRISE`, beside the images.

    They are what the robot knows before the image arrives: its proprioceptions, VP's latent, the
    last image that VP was given, and the time in s for which images have been withheld since.
    """
    return {
        "proprioception_history": (history, PROPRIOCEPTION_SIZE),
        "latent_vp": (LATENT,),
        "last_image": DEPTH_SHAPE,
        "image_age": (1,),
    }


def known_shapes(vision: Session, history: int) -> dict[str, tuple[int, ...]]:
    """Return the inputs of a vision model beside the images, by name.

    Args:
        vision: The model.
        history: Number of proprioceptions that the estimator sees.
    """
    outputs = {node.name for node in vision.get_outputs()}
    inputs = {}
    if SURPRISE in outputs:
        inputs |= recollection_shapes(history)
    if STILLNESS in outputs:
        inputs |= EVIDENCE
    return inputs


def read_model(path: Path, sha256: str | None) -> bytes:
    """Read a model; raises RenetError unless its digest is `sha256`, the manifest's."""
    data = read_bytes(path, MAX_MODEL_BYTES, "model")
    if hashlib.sha256(data).hexdigest() != sha256:
        raise RenetError(
            f"{path} is not the file the manifest describes (sha256 differs): export the bundle "
            "anew or fetch it again"
        )
    return data


def try_models(models: dict[str, bytes], history: int, where: str) -> None:
    """Run models once with each mask, in a process of its own; models that passed are remembered.

    Args:
        models: ONNX bytes by name, in the order of `MODELS`.
        history: Number of proprioceptions that the estimator sees.
        where: Name of the bundle, for messages.

    Raises:
        RenetError: A model cannot run, needs too much time or memory, or has outputs of another
            shape or type, or ones that are not finite.
    """
    digest = hashlib.sha256(b"".join([str(history).encode(), *models.values()])).hexdigest()
    if digest in _accepted:
        return
    sizes = json.dumps([history, {name: len(data) for name, data in models.items()}])
    run_trial("renet.bundle.models", [sizes], where, b"".join(models.values()))
    _accepted.add(digest)


def session(data: bytes) -> ort.InferenceSession:
    """Make a model ready to run on one thread of the CPU; several would spin between operations."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    # Errors reach the user as exceptions, so nothing is logged but what is fatal.
    options.log_severity_level = 4
    options.add_session_config_entry("session.load_model_format", "ONNX")
    return ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])


def remembers(estimator: Session) -> bool:
    """Return True if an estimator can do without an image; those of schema 1 cannot."""
    return HAS_IMAGE in {node.name for node in estimator.get_inputs()}


def problem(model: ort.InferenceSession, name: str, history: int) -> str:
    """Check a model's inputs, run it, and check its outputs.

    Args:
        model: The model.
        name: Its name, of `MODELS`.
        history: Number of proprioceptions that the estimator sees.

    Returns:
        A sentence that names the problem; empty if there is none.
    """
    inputs, outputs = model_shapes(history)[name]
    if name == "estimator" and remembers(model):
        inputs = inputs | {HAS_IMAGE: (1,)}
    names = [node.name for node in model.get_outputs()]
    if name == "vision":
        inputs = inputs | known_shapes(model, history)
        if STILLNESS in names:
            outputs = outputs | NEXT_EVIDENCE
    for optional in (VARIANCE, SURPRISE, STILLNESS, MAP_ERROR):
        if optional in names:
            outputs = outputs | {optional: ()}
    return _input_problem(model, name, inputs) or _run_problem(model, name, inputs, outputs)


def _input_problem(model: ort.InferenceSession, name: str, inputs: dict[str, tuple]) -> str:
    """Compare a model's inputs with those of these shapes; returns a sentence, empty if equal."""
    expected = {key: f"tensor(float) {shape} per robot" for key, shape in inputs.items()}
    actual = {n.name: f"{n.type} {tuple(n.shape[1:])} per robot" for n in model.get_inputs()}
    for key in expected | actual:
        if actual.get(key) != expected.get(key):
            return (
                f"{name}.onnx: input {key!r} is {actual.get(key, 'absent')}, "
                f"expected {expected.get(key, 'absent')}"
            )
    return ""


def _run_problem(
    model: ort.InferenceSession, name: str, inputs: dict[str, tuple], outputs: dict[str, tuple]
) -> str:
    """Run a model with each mask, and check outputs and time; returns a sentence, or nothing."""
    names = [node.name for node in model.get_outputs()]
    # The first run is the slowest, and another program may hold the processor up.
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
    """Try the models on standard input; returns a sentence that names the first problem."""
    history, sizes = json.loads(sys.argv[1])
    for name, size in sizes.items():
        data = sys.stdin.buffer.read(size)
        try:
            check_graph(data)
            verdict = problem(session(data), name, history)
        except ValueError as error:
            verdict = f"{name}.onnx is refused: {error}"
        # The exceptions of ONNX Runtime have no common class.
        except Exception as error:
            reason = shorten(str(error), 300, placeholder=" …") or type(error).__name__
            # ONNX Runtime has no exception of its own for want of memory.
            if "alloc" in reason:
                raise MemoryError from error
            verdict = f"{name}.onnx is not a model ONNX Runtime can run: {reason}"
        if verdict:
            return verdict
    return ""


if __name__ == "__main__":
    judge(_trial)
