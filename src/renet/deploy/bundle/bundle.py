"""A bundle: a folder with three ONNX models and the manifest that says how to use them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import onnxruntime as ort

from renet.deploy.bundle.manifest import SCHEMA, Manifest, from_json, to_json
from renet.errors import RenetError
from renet.interface import (
    ACTION_SIZE,
    DEPTH_SHAPE,
    FEET,
    FRAMES,
    HEIGHT_MAP_SIZE,
    LATENT,
    PROPRIOCEPTION_SIZE,
)

MANIFEST = "manifest.json"
MODELS = ("actor", "estimator", "vision")
DEFAULT = "go1-parkour"
"""The bundle that ships with the package."""


def model_shapes(history: int) -> dict[str, tuple[dict, dict]]:
    """Inputs and outputs of each model by name, without the batch axis."""
    depth = (FRAMES, *DEPTH_SHAPE)
    return {
        "actor": (
            {
                "proprioception": (PROPRIOCEPTION_SIZE,),
                "latent_op": (LATENT,),
                "latent_vp": (LATENT,),
                "op_mask": (1,),
            },
            {"action": (ACTION_SIZE,)},
        ),
        "estimator": (
            {
                "proprioception_history": (history, PROPRIOCEPTION_SIZE),
                "depth": depth,
                "latent_op": (LATENT,),
                "latent_vp": (LATENT,),
            },
            {
                "next_latent_op": (LATENT,),
                "next_latent_vp": (LATENT,),
                "velocity_op": (3,),
                "velocity_vp": (3,),
                "feet_height": (FEET,),
                "height_map": (HEIGHT_MAP_SIZE,),
            },
        ),
        "vision": ({"depth": depth}, {"reconstruction": depth, "anomaly_score": ()}),
    }


@dataclass(frozen=True)
class Bundle:
    """A loaded and verified bundle."""

    path: Path
    manifest: Manifest
    sessions: dict[str, ort.InferenceSession]

    @staticmethod
    def load(path: Path | str | None = None, threads: int = 1) -> Bundle:
        """Read and verify a bundle.

        Args:
            path: its folder; None is the one that ships with renet.
            threads: ONNX Runtime threads per model.

        Raises:
            RenetError: missing or altered file, other schema, or models that do not fit.
        """
        folder = pretrained(DEFAULT) if path is None else Path(path)
        manifest = read_manifest(folder)
        sessions = {}
        for name in MODELS:
            data = _read(folder / f"{name}.onnx")
            if hashlib.sha256(data).hexdigest() != manifest.sha256.get(f"{name}.onnx"):
                raise RenetError(
                    f"{folder / name}.onnx is not the file the manifest describes (sha256 "
                    "differs): export the bundle anew or fetch it again"
                )
            sessions[name] = _session(data, folder / f"{name}.onnx", threads)
            _check_shapes(sessions[name], name, manifest, folder)
        return Bundle(folder, manifest, sessions)

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.path.name

    @property
    def sha256(self) -> str:
        """One digest for how the bundle decides: of its models' digests and its selector."""
        digests = json.dumps(
            [self.manifest.sha256, to_json(self.manifest.selector)], sort_keys=True
        )
        return hashlib.sha256(digests.encode()).hexdigest()


def pretrained(name: str) -> Path:
    """Folder of a bundle that ships with renet."""
    return Path(str(files("renet").joinpath("pretrained", name)))


def read_manifest(folder: Path) -> Manifest:
    """Read and check `manifest.json` alone; raises RenetError."""
    if not folder.is_dir():
        raise RenetError(f"no bundle at {folder}: give a folder made by `renet export`")
    try:
        value = json.loads(_read(folder / MANIFEST))
    except ValueError as error:
        raise RenetError(f"{folder / MANIFEST} is not JSON: {error}") from error
    schema = value.get("schema") if isinstance(value, dict) else None
    if schema != SCHEMA:
        raise RenetError(f"{folder} has manifest schema {schema}; this renet reads {SCHEMA}")
    return from_json(Manifest, value)


def write_bundle(path: Path, models: dict[str, bytes], manifest: Manifest) -> Path:
    """Write a bundle beside its final place and rename it: nobody sees half of one.

    Raises:
        RenetError: `path` holds something that is not a bundle, or cannot be written.
    """
    path = path.resolve()  # "." has no name to rename to.
    if path.is_file() or (
        path.is_dir() and not (path / MANIFEST).is_file() and any(path.iterdir())
    ):
        raise RenetError(f"{path} exists and is not a bundle: choose another folder")
    digests = {f"{name}.onnx": hashlib.sha256(data).hexdigest() for name, data in models.items()}
    manifest = dataclasses.replace(manifest, sha256=digests)
    partial = path.with_name(f".{path.name}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        for name, data in models.items():
            (partial / f"{name}.onnx").write_bytes(data)
        (partial / MANIFEST).write_text(json.dumps(to_json(manifest), indent=1) + "\n")
        shutil.rmtree(path, ignore_errors=True)
        os.replace(partial, path)
    except OSError as error:
        raise RenetError(f"cannot write the bundle {path}: {error}") from error
    return path


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Replace a bundle's manifest atomically, its models untouched (`renet calibrate`)."""
    partial = folder / f".{MANIFEST}.partial"
    try:
        partial.write_text(json.dumps(to_json(manifest), indent=1) + "\n")
        os.replace(partial, folder / MANIFEST)
    except OSError as error:
        raise RenetError(f"cannot write {folder / MANIFEST}: {error}") from error


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise RenetError(f"the bundle lacks {path.name}: {error}") from error


def _session(data: bytes, path: Path, threads: int) -> ort.InferenceSession:
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    try:
        return ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime raises its own unrelated types.
        raise RenetError(f"{path} is not a model ONNX Runtime can run: {error}") from error


def _check_shapes(session: ort.InferenceSession, name: str, manifest: Manifest, path: Path) -> None:
    inputs, outputs = model_shapes(manifest.history)[name]
    for kind, expected, found in (
        ("input", inputs, session.get_inputs()),
        ("output", outputs, session.get_outputs()),
    ):
        shapes = {node.name: tuple(node.shape[1:]) for node in found}
        for key, shape in expected.items():
            if key not in shapes:
                raise RenetError(f"{path / name}.onnx has no {kind} {key!r}: wrong architecture")
            known = tuple(n for n in shapes[key] if isinstance(n, int))
            if len(known) == len(shapes[key]) and known != shape:
                raise RenetError(
                    f"{path / name}.onnx: {kind} {key!r} is {known} per robot, expected {shape}"
                )
