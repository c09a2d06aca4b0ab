"""Hostile files, each handed to the command that reads it: one line, exit code 2, nothing lost.

Every case runs in a process of its own, whose memory and time are measured.
"""

import hashlib
import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from onnx import TensorProto as Type
from onnx import helper
from safetensors.numpy import save_file

from renet.bundle import DEFAULT, MANIFEST, pretrained
from renet.cli import main
from renet.deploy.recording import CHUNK, MAGIC, TICK_DTYPE
from renet.models.config import ModelCfg
from renet.models.renet import RENet

from ..forked import Done, fork

info, node = helper.make_tensor_value_info, helper.make_node
MEMORY = 500_000
"""Kilobytes that a refusal may need beside what its command needs to start."""


def run(*arguments: str | Path) -> Done:
    return fork(main, list(map(str, arguments)))


@cache
def baseline(command: tuple[str, ...]) -> int:
    """Memory that a command needs to refuse a path that does not exist."""
    return run(*command, "/nowhere").peak


def refused(done: Done, *command: str) -> None:
    assert done.returncode == 2, done.stderr[-500:]
    assert "Traceback" not in done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("renet:")]
    assert len(lines) == 1
    assert len(done.stderr) < 2000
    assert "\x1b" not in done.stderr
    assert done.peak < baseline(command) + MEMORY


@pytest.fixture
def bundle(tmp_path) -> Path:
    return Path(shutil.copytree(pretrained(DEFAULT), tmp_path / "bundle"))


def edited(**changes) -> Callable[[Path], None]:
    def edit(path: Path) -> None:
        value = json.loads((path / MANIFEST).read_text())
        for key, fields in changes.items():
            value[key] = value[key] | fields if isinstance(fields, dict) else fields
        (path / MANIFEST).write_text(json.dumps(value))

    return edit


def text(content: str) -> Callable[[Path], None]:
    return lambda path: (path / MANIFEST).write_text(content)  # type: ignore[func-returns-value]


def fifo(path: Path) -> None:
    (path / MANIFEST).unlink()
    os.mkfifo(path / MANIFEST)


def device(path: Path) -> None:
    (path / MANIFEST).unlink()
    (path / MANIFEST).symlink_to("/dev/zero")


def model(path: Path, name: str, data: bytes) -> None:
    """Replace a model and make the manifest vouch for it."""
    (path / f"{name}.onnx").write_bytes(data)
    digests = {f"{name}.onnx": hashlib.sha256(data).hexdigest()}
    edited(sha256=digests)(path)


def actor(nodes: list, initializers=(), element=Type.FLOAT, **sizes) -> bytes:
    """An ONNX actor of our own making."""
    shapes = {"proprioception": 45, "latent_op": 64, "latent_vp": 64, "op_mask": 1} | sizes
    inputs = [info(n, element, ["n", s]) for n, s in shapes.items()]
    outputs = [info("action", element, None)]
    graph = helper.make_graph(nodes, "actor", inputs, outputs, list(initializers))
    opset = [helper.make_opsetid("", 17)]
    return helper.make_model(graph, opset_imports=opset, ir_version=8).SerializeToString()


def constant(value: float):
    return helper.make_tensor("c", Type.FLOAT, [1, 12], [value] * 12)


def add(name: str) -> list:
    return [node("Add", ["c", "op_mask"], [name])]


def external(path: Path) -> None:
    tensor = constant(0.1)
    tensor.ClearField("float_data")
    tensor.data_location = Type.EXTERNAL
    tensor.external_data.add(key="location", value="weights.bin")
    (path / "weights.bin").write_bytes(bytes(48))
    model(path, "actor", actor(add("action"), [tensor]))


def endless(path: Path) -> None:
    body = helper.make_graph(
        [node("Identity", ["go"], ["on"]), node("Identity", ["x"], ["y"])],
        "body",
        [info("i", Type.INT64, []), info("go", Type.BOOL, []), info("x", Type.FLOAT, None)],
        [info("on", Type.BOOL, []), info("y", Type.FLOAT, None)],
    )
    count = helper.make_tensor("count", Type.INT64, [], [2**62])
    yes = helper.make_tensor("yes", Type.BOOL, [], [True])
    loop = node("Loop", ["count", "yes", "c"], ["l"], body=body)
    nodes = [loop, node("Add", ["l", "op_mask"], ["action"])]
    model(path, "actor", actor(nodes, [count, yes, constant(0.0)]))


def gigantic(path: Path) -> None:
    shape = helper.make_tensor("shape", Type.INT64, [1], [4_000_000_000])
    nodes = [
        node("ConstantOfShape", ["shape"], ["big"]),
        node("ReduceSum", ["big"], ["s"], keepdims=0),
        node("Add", ["c", "s"], ["action"]),
    ]
    model(path, "actor", actor(nodes, [shape, constant(0.0)]))


BUNDLES: dict[str, Callable[[Path], object]] = {
    "manifest is a pipe": fifo,
    "manifest is a device": device,
    "manifest of 300 MB": lambda p: os.truncate(p / MANIFEST, 300_000_000),
    "manifest nested a million deep": text("[" * 1_000_000),
    "manifest of one long number": text("1" * 100_000),
    "manifest of another type": text("[1, 2]"),
    "Kp 1000": edited(robot={"stiffness": [1000.0] * 12}),
    "beta 1e300": edited(selector={"beta": 1e300}),
    "history 1e9": edited(history=10**9),
    "escape codes in a text": edited(provenance={"task": "\x1b]0;owned\x07"}),
    "a text of a megabyte": edited(provenance={"task": "x" * 1_000_000}),
    "model of 4 GB": lambda p: os.truncate(p / "actor.onnx", 4_000_000_000),
    "model that loops for ever": endless,
    "model that asks for 16 GB": gigantic,
    "model with weights elsewhere": external,
    "model that gives NaN": lambda p: model(p, "actor", actor(add("action"), [constant(np.nan)])),
    "model of another type": lambda p: model(
        p, "actor", actor([node("Cast", ["op_mask"], ["action"], to=11)], element=Type.DOUBLE)
    ),
    "model of symbolic sizes": lambda p: model(
        p, "actor", actor(add("action"), [constant(0.1)], proprioception="k")
    ),
    "model that is text": lambda p: model(p, "vision", b"hello"),
}


@pytest.mark.parametrize("spoil", BUNDLES.values(), ids=BUNDLES)
def test_bundles(bundle, tmp_path, spoil):
    spoil(bundle)
    before = sorted(str(p) for p in tmp_path.rglob("*"))
    out = tmp_path / "out"
    refused(run("deploy", bundle, "--seconds", "0.1", "--out", out), "deploy")
    assert sorted(str(p) for p in tmp_path.rglob("*")) == before


def test_markup_in_a_bundle_is_printed_as_it_is(bundle):
    markup = "[bold red]x[/]"
    edited(provenance={"task": markup}, robot={"name": markup})(bundle)
    done = run("bundle", "inspect", bundle)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(markup) == 2, "in a line and over a table"


def chunk(tag: bytes, data: bytes) -> bytes:
    packed = zlib.compress(data)
    return CHUNK.pack(tag, len(packed), zlib.crc32(packed)) + packed


HEAD = MAGIC + chunk(b"HEAD", b"{}")


def ticks(**fields) -> bytes:
    rows = np.zeros(3, TICK_DTYPE)
    rows["now"] = [1.0, 1.02, 1.04]
    for name, value in fields.items():
        rows[name] = value
    return HEAD + chunk(b"TICK", rows.tobytes())


RECORDINGS = {
    "a bomb of zeros": HEAD + chunk(b"TICK", bytes(2_000_000_000 // TICK_DTYPE.itemsize)) * 60_000,
    "one chunk of 100 MB": HEAD + chunk(b"TICK", bytes(TICK_DTYPE.itemsize * 60_000)),
    "text for a number": MAGIC + chunk(b"HEAD", b'{"beta": "low", "onsets": ["now"]}'),
    "a deep header": MAGIC + chunk(b"HEAD", b'{"a":' * 100_000),
    "times of 1e15": ticks(now=[0.0, 1.0, 1e15]),
    "times that are not numbers": ticks(now=[0.0, np.nan, 1.0]),
    "times that run backwards": ticks(now=[2.0, 1.0, 3.0]),
    "mode 77": ticks(mode=77),
    "an image of tick 1e9": ticks() + chunk(b"IMAG", struct.pack("<I", 10**9) + bytes(6144)),
    "a length of 4 GB": HEAD + CHUNK.pack(b"TICK", 2**32 - 1, 0),
    "no header": MAGIC + b"x" * 100,
}


@pytest.mark.parametrize("data", RECORDINGS.values(), ids=RECORDINGS)
def test_recordings(tmp_path, data):
    path = tmp_path / "recording.log"
    path.write_bytes(data)
    done = run("evaluate", "log", path, "--out", tmp_path / "out")
    if done.returncode == 0:  # Read up to the damage: an empty run.
        assert json.loads((tmp_path / "out" / "score.json").read_text())["seconds"] == 0.0
    else:
        refused(done, "evaluate", "log")
        assert not (tmp_path / "out").exists()


SCENES = {
    "a billion bodies": ("", '<replicate count="1000000000"><geom size="1"/></replicate>'),
    "a height field of 60,000 squared": (
        '<hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/>',
        '<geom type="hfield" hfield="h"/>',
    ),
    "a pipe for a texture": (
        '<texture type="2d" name="t" file="pipe.png"/><material name="m" texture="t"/>',
        '<geom type="plane" size="1 1 1" material="m"/>',
    ),
    "a file of the system": ("", '<include file="/etc/passwd"/>'),
}


@pytest.mark.parametrize(("assets", "body"), SCENES.values(), ids=SCENES)
def test_scenes(tmp_path, assets, body):
    os.mkfifo(tmp_path / "pipe.png")
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco><asset>{assets}</asset><worldbody>{body}</worldbody></mujoco>")
    options = ["--scene", str(path), "--seconds", "0.1", "--out", str(tmp_path / "out")]
    refused(run("deploy", *options), "deploy")
    assert not (tmp_path / "out").exists()


CHECKPOINTS: dict[str, dict | str] = {
    "no task": {"format": 1, "config": {"model": {}}},
    "history 1e9": {"format": 1, "task": "", "config": {"model": {"history": 10**9}}},
    "hidden abc": {"format": 1, "task": "", "config": {"model": {"hidden": "abc"}}},
    "a list": "[]",
    "deep": "[" * 1_000_000,
}


@pytest.fixture
def checkpoint(tmp_path) -> Path:
    folder = tmp_path / "it_00000001"
    folder.mkdir()
    (folder / "state.json").write_text('{"format": 1}')
    tensors = {"critic_normalizer._mean": np.zeros((1, 10), np.float32)}
    for name in ("model", "environment"):
        save_file(tensors, folder / f"{name}.safetensors")
    return folder


@pytest.mark.parametrize("state", CHECKPOINTS.values(), ids=CHECKPOINTS)
def test_checkpoints(checkpoint, tmp_path, state):
    content = state if isinstance(state, str) else json.dumps(state)
    (checkpoint / "state.json").write_text(content)
    refused(run("export", checkpoint, "--out", tmp_path / "out"), "export")
    assert not (tmp_path / "out").exists()


def test_a_checkpoint_of_holes(checkpoint, tmp_path):
    """On the disk it takes 20 kB, in memory 0.6 GB: its weights fit the settings it states."""
    model = {"critic_hidden": [12_000, 12_000]}
    state = {"format": 1, "task": "", "config": {"model": model}}
    (checkpoint / "state.json").write_text(json.dumps(state))
    header, end = {}, 0
    with torch.device("meta"):
        weights = RENet(ModelCfg(critic_hidden=(12_000, 12_000)), 10).state_dict()
    for name, value in weights.items():
        kind = "I64" if value.dtype == torch.int64 else "F32"
        places = [end, end := end + value.nbytes]
        header[name] = {"dtype": kind, "shape": list(value.shape), "data_offsets": places}
    text, file = json.dumps(header).encode(), checkpoint / "model.safetensors"
    file.write_bytes(struct.pack("<Q", len(text)) + text)
    os.truncate(file, 8 + len(text) + end)
    (checkpoint / "average.safetensors").symlink_to(file)
    refused(run("export", checkpoint, "--out", tmp_path / "out"), "export")


def test_a_checkpoint_of_pipes(checkpoint, tmp_path):
    (checkpoint / "model.safetensors").unlink()
    os.mkfifo(checkpoint / "model.safetensors")
    refused(run("export", checkpoint, "--out", tmp_path / "out"), "export")
