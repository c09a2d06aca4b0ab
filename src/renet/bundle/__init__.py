"""A bundle: a folder with three ONNX models and the manifest that says how to use them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path

from renet.bundle.blocks import BlockSession, Session
from renet.bundle.contents import COMPANIONS, MANIFEST, OURS, PREVIOUS
from renet.bundle.hub import REPOSITORY, fetch, is_remote
from renet.bundle.manifest import NEWEST_SCHEMA, READABLE_SCHEMAS, Manifest
from renet.bundle.models import (
    HAS_IMAGE,
    MAP_ERROR,
    MODELS,
    STILLNESS,
    SURPRISE,
    VARIANCE,
    read_model,
    remembers,
    session,
    try_models,
)
from renet.conversion import from_json
from renet.errors import RenetError
from renet.files import MAX_JSON, is_temporary, read_bytes, read_object, write_atomically
from renet.folders import demand_own, write_folder

SHIPPED = ("go1-parkour", "go1-driven", "go2-parkour", "go2-driven")
"""Names of the bundles that ship with the package."""
DEFAULT = SHIPPED[0]
"""Name of the bundle that is loaded where none is named."""


@dataclass(frozen=True)
class Bundle:
    """A loaded and verified bundle."""

    path: Path
    manifest: Manifest
    sessions: Mapping[str, Session]

    @staticmethod
    def load(path: Path | str | None = None, threads: int = 1) -> Bundle:
        """Read and verify a bundle.

        Args:
            path: A bundle's folder, the name of a bundle that ships with renet, or
                `hf://owner/name` for one on the Hugging Face Hub; None means `DEFAULT`.
            threads: Threads that share a batch of robots. Results do not depend on it.

        Raises:
            RenetError: A file is missing or altered, the schema is another one, the models do not
                fit, or the Hub cannot be reached.
        """
        folder = find_bundle(path)
        manifest = read_manifest(folder)
        models = {}
        for name in MODELS:
            file = f"{name}.onnx"
            models[name] = read_model(folder / file, manifest.sha256.get(file))
        # No model is run in this process before it has run in one with limits.
        try_models(models, manifest.history, str(folder))
        sessions: dict[str, Session] = {}
        for name, data in models.items():
            single = session(data)
            sessions[name] = single if threads == 1 else BlockSession(single, threads)
        bundle = Bundle(folder, manifest, sessions)
        bundle._check_selector()
        return bundle

    def _check_selector(self) -> None:
        """Raise RenetError if the selector needs an input or output that the models lack."""
        selector = self.manifest.selector
        needed = {
            "variance": ("vision", VARIANCE),
            "surprise": ("vision", SURPRISE),
            "stillness": ("vision", STILLNESS),
            "map_error": ("estimator", MAP_ERROR),
        }
        for name, (model, output) in needed.items():
            if name in selector.thresholds and output not in self.outputs(model):
                raise RenetError(
                    f"{self.path}: the selector has a threshold of the {name.replace('_', ' ')}, "
                    f"but {model}.onnx has no {output}: run `renet calibrate`"
                )
        if selector.longest_memory and not remembers(self.sessions["estimator"]):
            raise RenetError(
                f"{self.path}: the selector lets VP drive without an image, but estimator.onnx has "
                f"no input {HAS_IMAGE}: set selector.longest_memory to 0"
            )

    def outputs(self, model: str) -> set[str]:
        """Names of a model's outputs."""
        return {output.name for output in self.sessions[model].get_outputs()}

    @property
    def predicts_variance(self) -> bool:
        """True if the detector predicts the variance of its own error."""
        return VARIANCE in self.outputs("vision")

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.path.name

    @property
    def sha256(self) -> str:
        """Hexadecimal SHA-256 of the models' digests and the selector: of all that decides."""
        selector = dataclasses.asdict(self.manifest.selector)
        # Bundles from before memory keep their digest.
        if not selector["longest_memory"]:
            del selector["longest_memory"]
        digests = json.dumps([self.manifest.sha256, selector], sort_keys=True)
        return hashlib.sha256(digests.encode()).hexdigest()


def find_bundle(name: Path | str | None = None) -> Path:
    """Return the folder that a name stands for, which need not hold a bundle; raises as `fetch`."""
    if name is None:
        return pretrained(DEFAULT)
    if is_remote(name):
        return fetch(name)
    folder = Path(name)
    if str(folder) in SHIPPED and not folder.exists():
        return pretrained(str(folder))
    return folder


def pretrained(name: str) -> Path:
    """Return the folder of a bundle that ships with renet."""
    return Path(str(files("renet").joinpath("pretrained", name)))


def read_manifest(folder: Path) -> Manifest:
    """Read and check `manifest.json` alone; raises RenetError, also for a file of no bundle."""
    if not folder.is_dir():
        raise RenetError(f"no bundle at {folder}: {_instead(str(folder))}")
    if not os.path.lexists(folder / MANIFEST):
        raise RenetError(f"{folder} is no bundle, without {MANIFEST}: {_instead(str(folder))}")
    # A link or a foreign file may lead out of the folder, or be lost when the bundle is replaced.
    for path in sorted(folder.iterdir()):
        regular = path.is_file() and (path.name in OURS or is_temporary(path.name))
        if path.is_symlink() or not (regular or path.name in COMPANIONS):
            raise RenetError(
                f"{folder} holds {path.name}, which is a link or no part of a bundle: copy the "
                "bundle's files alone to another folder"
            )
    value = read_object(folder / MANIFEST, "manifest")
    if value.get("schema") not in READABLE_SCHEMAS:
        schema = str(value.get("schema"))[:40]
        readable = " and ".join(map(str, READABLE_SCHEMAS))
        raise RenetError(f"{folder} has manifest schema {schema}; this renet reads {readable}")
    source = f"the manifest {folder / MANIFEST}"
    return from_json(Manifest, value, source, "export the bundle anew")


def _instead(name: str) -> str:
    """Return what to give in place of a name that is no bundle's."""
    nearest = get_close_matches(name, SHIPPED, cutoff=0.7)
    if nearest:
        verb = "ships" if len(nearest) == 1 else "ship"
        return f"did you mean {' or '.join(nearest)}, which {verb} with renet?"
    choices = f"give a folder made by `renet export`, or {' or '.join(SHIPPED)}, which ship"
    if re.fullmatch(REPOSITORY, name):
        choices += f"; a bundle on the Hugging Face Hub is hf://{name}"
    return choices


def write_bundle(path: Path, models: dict[str, bytes], manifest: Manifest) -> Path:
    """Write a bundle, or replace one; a failure leaves the folder as it was.

    Args:
        path: Folder of the bundle.
        models: ONNX bytes by the models' names.
        manifest: Manifest without digests, which are added here.

    Raises:
        RenetError: The folder holds anything but a bundle's files, the models do not fit the
            manifest, or it cannot be written.
    """
    # A relative path is lost once the current folder itself is replaced.
    path = path.resolve()
    try_models({name: models[name] for name in MODELS}, manifest.history, "the new bundle")
    contents = {f"{name}.onnx": data for name, data in models.items()}
    digests = {name: hashlib.sha256(data).hexdigest() for name, data in contents.items()}
    contents[MANIFEST] = _json(dataclasses.replace(manifest, sha256=digests))
    demand_own(path, OURS, "bundle")
    if path.is_dir() and any(path.iterdir()):
        try:
            read_manifest(path)
        except RenetError as error:
            raise RenetError(f"{path} is not a bundle ({error}): choose another folder") from error
    write_folder(path, contents, OURS, "bundle")
    return path


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Replace a bundle's manifest alone; the old one is kept as `PREVIOUS`. Raises RenetError."""
    before = read_bytes(folder / MANIFEST, MAX_JSON, "manifest")
    write_atomically(folder / PREVIOUS, before, "manifest")
    write_atomically(folder / MANIFEST, _json(manifest), "manifest")


def _json(manifest: Manifest) -> bytes:
    manifest = dataclasses.replace(manifest, schema=NEWEST_SCHEMA)
    return (json.dumps(dataclasses.asdict(manifest), indent=1) + "\n").encode()
