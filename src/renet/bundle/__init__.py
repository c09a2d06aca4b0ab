"""A bundle: a folder with three ONNX models and the manifest that says how to use them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from renet.bundle.blocks import BlockSession, Session
from renet.bundle.contents import COMPANIONS, MANIFEST, OURS, PREVIOUS
from renet.bundle.hub import fetch, is_remote
from renet.bundle.manifest import SCHEMA, SCHEMAS, Manifest
from renet.bundle.models import (
    HAS_IMAGE,
    MAP_ERROR,
    MODELS,
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

DEFAULT, *_ = SHIPPED = ("go1-parkour", "go2-parkour")
"""The bundles that ship with the package; the first where none is asked for."""


@dataclass(frozen=True)
class Bundle:
    """A loaded and verified bundle."""

    path: Path
    manifest: Manifest
    sessions: Mapping[str, Session]

    @staticmethod
    def load(path: Path | str | None = None, threads: int = 1) -> Bundle:
        """Read and verify the bundle in a folder or, where there is none, the shipped one so named.

        None means `DEFAULT`; `hf://owner/name` is loaded from the Hugging Face Hub. With several
        `threads`, these share the robots that a model runs for; its results are the same.

        Raises:
            RenetError: missing or altered file, other schema, models that do not fit, or a name on
                the Hub that cannot be loaded.
        """
        folder = find_bundle(path)
        manifest = read_manifest(folder)
        models = {
            name: read_model(folder / f"{name}.onnx", manifest.sha256.get(f"{name}.onnx"))
            for name in MODELS
        }
        try_models(models, manifest.history, str(folder))
        single = {name: session(data) for name, data in models.items()}
        sessions: Mapping[str, Session] = single
        if threads > 1:
            sessions = {name: BlockSession(one, threads) for name, one in single.items()}
        bundle = Bundle(folder, manifest, sessions)
        needed = {"variance": ("vision", VARIANCE), "map_error": ("estimator", MAP_ERROR)}
        for name, (model, output) in needed.items():
            if name in manifest.selector.thresholds and output not in bundle.outputs(model):
                raise RenetError(
                    f"{folder}: the selector has a threshold of the {name.replace('_', ' ')}, but"
                    f" {model}.onnx has no {output}: run `renet calibrate`"
                )
        if manifest.selector.longest_memory and not remembers(sessions["estimator"]):
            raise RenetError(
                f"{folder}: the selector lets VP drive without an image, but estimator.onnx has no"
                f" input {HAS_IMAGE}: set selector.longest_memory to 0"
            )
        return bundle

    def outputs(self, model: str) -> set[str]:
        """Names of a model's outputs."""
        return {output.name for output in self.sessions[model].get_outputs()}

    @property
    def predicts_variance(self) -> bool:
        """Whether its detector predicts the variance of its own error."""
        return VARIANCE in self.outputs("vision")

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.path.name

    @property
    def sha256(self) -> str:
        """The digest of all that decides, models' digests and the selector, in hexadecimal."""
        selector = dataclasses.asdict(self.manifest.selector)
        if not selector["longest_memory"]:  # Bundles from before memory keep their digest.
            del selector["longest_memory"]
        digests = json.dumps([self.manifest.sha256, selector], sort_keys=True)
        return hashlib.sha256(digests.encode()).hexdigest()


def find_bundle(name: Path | str | None = None) -> Path:
    """The folder that a bundle's name stands for, which need not be one; raises as `fetch`."""
    if name is None:
        return pretrained(DEFAULT)
    if is_remote(name):
        return fetch(name)
    folder = Path(name)
    if str(folder) in SHIPPED and not folder.exists():
        return pretrained(str(folder))
    return folder


def pretrained(name: str) -> Path:
    """Folder of a bundle that ships with renet."""
    return Path(str(files("renet").joinpath("pretrained", name)))


def read_manifest(folder: Path) -> Manifest:
    """Read and check `manifest.json` alone; raises RenetError, also where a file is foreign."""
    if not folder.is_dir():
        raise RenetError(f"no bundle at {folder}: give a folder made by `renet export`")
    for path in sorted(folder.iterdir()):
        regular = path.is_file() and (path.name in OURS or is_temporary(path.name))
        if path.is_symlink() or not (regular or path.name in COMPANIONS):
            raise RenetError(
                f"{folder} holds {path.name}, which is a link or no part of a bundle: copy the "
                "bundle's files alone to another folder"
            )
    value = read_object(folder / MANIFEST, "manifest")
    if value.get("schema") not in SCHEMAS:
        schema = str(value.get("schema"))[:40]
        readable = " and ".join(map(str, SCHEMAS))
        raise RenetError(f"{folder} has manifest schema {schema}; this renet reads {readable}")
    source = f"the manifest {folder / MANIFEST}"
    return from_json(Manifest, value, source, "export the bundle anew")


def write_bundle(path: Path, models: dict[str, bytes], manifest: Manifest) -> Path:
    """Write a bundle whole, or replace one: ONNX bytes by name and a manifest without digests.

    Raises:
        RenetError: the folder holds anything that is not a bundle's, which stays as it is; the
            models do not fit the manifest; or it cannot be written.
    """
    path = path.resolve()  # Which the current folder no longer is once it is replaced.
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
    """Replace a bundle's manifest alone; the old one stays as `PREVIOUS`. Raises RenetError."""
    before = read_bytes(folder / MANIFEST, MAX_JSON, "manifest")
    write_atomically(folder / PREVIOUS, before, "manifest")
    write_atomically(folder / MANIFEST, _json(manifest), "manifest")


def _json(manifest: Manifest) -> bytes:
    manifest = dataclasses.replace(manifest, schema=SCHEMA)
    return (json.dumps(dataclasses.asdict(manifest), indent=1) + "\n").encode()
