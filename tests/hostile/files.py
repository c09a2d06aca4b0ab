"""Ninety files and folders that nobody should hand to renet, by name."""

import hashlib
import json
import os
import shutil
import socket
import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import onnx.parser
import zstandard
from mcap.opcode import Opcode
from safetensors.numpy import save_file

from renet.bundle import DEFAULT, MANIFEST, PREVIOUS, pretrained
from renet.deploy.recording.channels import ChannelWriter, DepthImage, Topic, encode
from renet.deploy.recording.reader import EARLIER, MAGIC, RECORD
from renet.deploy.recording.tick import TICK_DTYPE

Maker = Callable[[Path], Path | str | None]
"""Fills a new folder; returns what to hand over, the folder itself by default."""


def file(data: bytes | str, name: str = "file") -> Maker:
    def make(folder: Path) -> Path:
        content = data.encode() if isinstance(data, str) else data
        (folder / name).write_bytes(content)
        return folder / name

    return make


def sparse(size: int, head: bytes = b"") -> Maker:
    def make(folder: Path) -> Path:
        path = file(head)(folder)
        assert isinstance(path, Path)
        os.truncate(path, size)
        return path

    return make


def link(target: str) -> Maker:
    def make(folder: Path) -> Path:
        (folder / "link").symlink_to(target)
        return folder / "link"

    return make


def pipe(folder: Path) -> Path:
    os.mkfifo(folder / "pipe")
    return folder / "pipe"


def unix_socket(folder: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as server:
        here = os.open(folder, os.O_RDONLY)
        server.bind(f"/proc/self/fd/{here}/socket")  # Its path may be too long for a socket's.
        os.close(here)
    return folder / "socket"


def deep(folder: Path) -> Path:
    start = folder
    for _ in range(300):
        (folder := folder / "d").mkdir()
    return start


def bundle(edit: Callable[[Path], object]) -> Maker:
    """The shipped bundle after a change."""

    def make(folder: Path) -> Path:
        path = Path(shutil.copytree(pretrained(DEFAULT), folder / "bundle"))
        edit(path)
        return path

    return make


def manifest(**changes: object) -> Maker:
    def edit(path: Path) -> None:
        value = json.loads((path / MANIFEST).read_text())
        for key, fields in changes.items():
            value[key] = value[key] | fields if isinstance(fields, dict) else fields
        (path / MANIFEST).write_text(json.dumps(value))

    return bundle(edit)


def text(content: str) -> Maker:
    return bundle(lambda path: (path / MANIFEST).write_text(content))


def without(name: str, replace: Callable[[Path], object]) -> Maker:
    """A bundle with something else in place of one of its files."""

    def edit(path: Path) -> None:
        (path / name).unlink()
        replace(path / name)

    return bundle(edit)


def model(name: str, data: bytes) -> Maker:
    """A bundle with another model, for which its manifest vouches."""

    def edit(path: Path) -> None:
        value = json.loads((path / MANIFEST).read_text())
        value["sha256"][f"{name}.onnx"] = hashlib.sha256(data).hexdigest()
        (path / MANIFEST).write_text(json.dumps(value))
        (path / f"{name}.onnx").write_bytes(data)

    return bundle(edit)


def actor(nodes: str, kind: str = "float", size: object = 45) -> Maker:
    """An actor of somebody's making, in ONNX's own language."""
    text = f"""<ir_version: 8, opset_import: ["" : 17]>
        actor ({kind}[n, {size}] proprioception, {kind}[n, 64] latent_op,
               {kind}[n, 64] latent_vp, {kind}[n, 1] op_mask) => ({kind}[] action)
        <float[1, 12] c = {{{", ".join(["0.1"] * 12)}}}, int64[1] five = {{5}},
         float[1] limit = {{0.7}}, float minus = {{-1}}, int64[1] shape = {{4000000000}},
         bool yes = {{1}}, int64 count = {{{2**62}}}>
        {{ {nodes} }}"""
    return model("actor", onnx.parser.parse_model(text).SerializeToString())


UPSIDE_DOWN = """g = Gather <axis = 1> (proprioception, five)
    b = Greater (g, limit)
    up = Squeeze (b)"""
"""Whether the robot's gravity points up, which it does in no trial."""
LOOP = """<body = loop (int64 i, bool go, float[] x) => (bool on, float[] y)
    {on = Identity (go) y = Identity (x)}>"""


Messages = list[tuple[Topic, bytes]]
EMPTY: Messages = [(Topic.RUN, b"{}")]
"""A header that says nothing."""


def recording(*chunks: Messages) -> bytes:
    """A recording without its index, whose chunks hold messages."""
    stream = BytesIO()
    writer = ChannelWriter(stream)
    for messages in chunks:
        for topic, message in messages:
            writer.write(topic, 0.0, message)
        writer.flush()
    return stream.getvalue()


def messages(rows: np.ndarray) -> Messages:
    return [(Topic.TICK, encode(row)) for row in rows]


def ticks(**fields: object) -> bytes:
    rows = np.zeros(3, TICK_DTYPE)
    rows["now"] = [1.0, 1.02, 1.04]
    for name, value in fields.items():
        rows[name] = value
    return recording(EMPTY, messages(rows))


def chunk(packed: bytes, size: int, check: int = 0) -> bytes:
    """A chunk that states the size and checksum of what it unpacks to."""
    name = b"zstd"
    head = struct.pack("<QQQII", 0, 0, size, check, len(name)) + name
    content = head + struct.pack("<Q", len(packed)) + packed
    return RECORD.pack(Opcode.CHUNK, len(content)) + content


def loop(opcode: int) -> bytes:
    """A record of MCAP that states more entries than it has, before a hole."""
    return RECORD.pack(opcode, 6) + struct.pack("<HI", 1, 2**32 - 1)


HEAD = recording(EMPTY)
COUNT = 3_900_000 // (TICK_DTYPE.itemsize + 35)
SECOND = recording(EMPTY, messages(np.zeros(COUNT, TICK_DTYPE)))[len(HEAD) :]
"""Chunks of 3.8 MB in all, of ticks at time zero."""
ZEROS = zstandard.compress(bytes(100_000_000))
CHANNEL = b"\x02\x00\x00\x00\x05\x00\x00\x00/tick\x03\x00\x00\x00cdr\x00\x00\x00\x00"
"""A channel /tick of messages without a schema."""


STATE = {"format": 1, "iteration": 1, "steps": 1, "seconds": 1.0, "task": ""}
"""What a run writes of itself."""


def model_of(**settings: object) -> dict[str, object]:
    return STATE | {"config": {"model": settings, "algorithm": {}}}


def checkpoint(state: object, tensors: Callable[[Path], object] | None = None) -> Maker:
    """A checkpoint of a state and of tensors that are no model's."""

    def make(folder: Path) -> Path:
        path = folder / "it_00000001"
        path.mkdir()
        content = state if isinstance(state, str) else json.dumps(state)
        (path / "state.json").write_text(content)
        arrays = {"critic_normalizer._mean": np.zeros((1, 10), np.float32)}
        for name in ("model", "environment"):
            save_file(arrays, path / f"{name}.safetensors")
        if tensors is not None:
            (path / "model.safetensors").unlink()
            tensors(path / "model.safetensors")
        return path

    return make


def claims(size: int, header: bytes) -> Callable[[Path], None]:
    """A sparse file of tensors: its header, and a hole."""

    def make(path: Path) -> None:
        path.write_bytes(struct.pack("<Q", len(header)) + header)
        os.truncate(path, size)

    return make


def holes(folder: Path) -> Path:
    """A checkpoint of 20 kB on the disk and 0.6 GB in memory, which fits the settings it states."""
    import torch

    from renet.models.config import ModelCfg
    from renet.models.renet import RENet

    path = checkpoint(model_of(critic_hidden=[12_000, 12_000]))(folder)
    assert isinstance(path, Path)
    with torch.device("meta"):
        weights = RENet(ModelCfg(critic_hidden=(12_000, 12_000)), 10).state_dict()
    header, end = {}, 0
    for name, value in weights.items():
        kind = "I64" if value.dtype == torch.int64 else "F32"
        places = [end, end := end + value.nbytes]
        header[name] = {"dtype": kind, "shape": list(value.shape), "data_offsets": places}
    text = json.dumps(header).encode()
    claims(8 + len(text) + end, text)(path / "model.safetensors")
    (path / "average.safetensors").symlink_to("model.safetensors")
    return path


def results(write: Callable[[Path], object]) -> Maker:
    """A folder with the results of a study."""

    def make(folder: Path) -> Path:
        (folder / "noise").mkdir()
        write(folder / "noise" / "summary.json")
        return folder

    return make


def scene(assets: str, body: str) -> Maker:
    def make(folder: Path) -> Path:
        os.mkfifo(folder / "pipe.png")
        content = f"<mujoco><asset>{assets}</asset><worldbody>{body}</worldbody></mujoco>"
        return file(content, "scene.xml")(folder)  # type: ignore[return-value]

    return make


TENSOR = b'{"a":{"dtype":"F32","shape":[250000000],"data_offsets":[0,1000000000]}}'
FILES: dict[str, Maker] = {
    "nothing": lambda folder: folder / "nowhere",
    "an empty folder": lambda folder: None,
    "an empty file": file(b""),
    "text": file("years of work"),
    "bytes": file(bytes(range(256)) * 100),
    "a pipe": pipe,
    "a socket": unix_socket,
    "a device without end": lambda folder: "/dev/zero",
    "a link to a device": link("/dev/zero"),
    "a link to nothing": link("nowhere"),
    "a link to itself": link("link"),
    "a file of 4 GB on paper": sparse(4_000_000_000),
    "folders 300 deep": deep,
    "a name of 300 letters": lambda folder: folder / ("x" * 300),
    "a name with a null byte": lambda folder: f"{folder}/a\0b",
    "a name that commands a terminal": lambda folder: file("", "\x1b]0;owned\x07")(folder),
    "a name of two lines": lambda folder: file("", "a\nb")(folder),
    "a name that is no text": lambda folder: os.fsdecode(os.fsencode(folder) + b"/\xff"),
    "JSON": file('{"a": 1}'),
    "deep JSON": file("[" * 1_000_000),
    "a page": file("<html></html>", "page.html"),
    "a manifest that is a pipe": without(MANIFEST, os.mkfifo),
    "a manifest that is a device": without(MANIFEST, lambda p: p.symlink_to("/dev/zero")),
    "a manifest of 300 MB": bundle(lambda p: os.truncate(p / MANIFEST, 300_000_000)),
    "a manifest nested a million deep": text("[" * 1_000_000),
    "a manifest of one long number": text("1" * 100_000),
    "a manifest of another type": text("[1, 2]"),
    "Kp -1000": manifest(robot={"stiffness": [-1000.0] * 12}),
    "beta 1e300": manifest(selector={"beta": 1e300}),
    "history 1e9": manifest(history=10**9),
    "escape codes in a text": manifest(provenance={"task": "\x1b]0;owned\x07"}),
    "a text of a megabyte": manifest(provenance={"task": "x" * 1_000_000}),
    "a model of 4 GB": bundle(lambda p: os.truncate(p / "actor.onnx", 4_000_000_000)),
    "a model that is a link": without("actor.onnx", lambda p: p.symlink_to("/etc/passwd")),
    "a link for a temporary": bundle(lambda p: (p / ".manifest.json.partial").symlink_to("/x")),
    "a link for what was before": bundle(lambda p: (p / PREVIOUS).symlink_to("../../../victim")),
    "a link for a card": bundle(lambda p: (p / "README.md").symlink_to("../../../victim")),
    "a pipe for what was before": bundle(lambda p: os.mkfifo(p / PREVIOUS)),
    "a file too many": bundle(lambda p: (p / "thesis.tex").write_text("years of work")),
    "a model that loops for ever": actor(
        f"l = Loop {LOOP} (count, yes, c) action = Add (l, op_mask)"
    ),
    "a model that does so upside down": actor(
        f"{UPSIDE_DOWN} l = Loop {LOOP} (count, up, c) action = Add (l, op_mask)"
    ),
    "a model that branches": actor(
        f"""{UPSIDE_DOWN}
        i = If (up) <then_branch = t () => (float[] t) {{t = Identity (c)}},
                     else_branch = e () => (float[] e) {{e = Identity (c)}}>
        action = Add (i, op_mask)"""
    ),
    "a model that asks for 16 GB": actor(
        "big = Expand (limit, shape) s = ReduceSum <keepdims = 0> (big) action = Add (c, s)"
    ),
    "a model that asks for what gravity says": actor(
        f"{UPSIDE_DOWN} k = Cast <to = 7> (b) s = Squeeze (k) action = Expand (c, s)"
    ),
    "a model that throws dice": actor("action = RandomNormalLike (c)"),
    "a model with NaN": actor("nan = Sqrt (minus) a = Add (c, nan) action = Add (a, op_mask)"),
    "a model of another type": actor("action = Cast <to = 11> (op_mask)", "double"),
    "a model of symbolic sizes": actor("action = Add (c, op_mask)", size="k"),
    "a model in ONNX Runtime's format": model("actor", b"\x18\0\0\0ORTM" + bytes(1000)),
    "a model that is text": model("vision", b"hello"),
    "a bomb of zeros": file(HEAD + SECOND * 60),
    "a sparse bomb": sparse(1_000_000_000, HEAD + SECOND * 60),
    "one chunk of 100 MB": file(HEAD + chunk(ZEROS, 100_000_000)),
    "a chunk of 100 MB that states 1 MB": file(MAGIC + chunk(ZEROS, 1_000_000)),
    "an index without end": sparse(3_000_000_000, MAGIC + loop(Opcode.MESSAGE_INDEX)),
    "statistics without end": sparse(3_000_000_000, MAGIC + loop(Opcode.STATISTICS)),
    "a recording of renet 0.1": file(EARLIER + b"4\n" + bytes(100)),
    "a log of another program": file(
        MAGIC + RECORD.pack(Opcode.CHANNEL, len(CHANNEL)) + CHANNEL, "other.mcap"
    ),
    "text for a number": file(recording([(Topic.RUN, b'{"level": "low", "onsets": ["now"]}')])),
    "a deep header": file(recording([(Topic.RUN, b'{"a":' * 100_000)])),
    "times of 1e15": file(ticks(now=[0.0, 1.0, 1e15])),
    "times that are not numbers": file(ticks(now=[0.0, np.nan, 1.0])),
    "times that run backwards": file(ticks(now=[2.0, 1.0, 3.0])),
    "mode 77": file(ticks(mode=77)),
    "images of no tick": file(
        recording(EMPTY, 2 * [(Topic.DEPTH, encode(DepthImage(0.0, np.zeros((48, 64)))))])
    ),
    "an image of no pixels": file(recording(EMPTY, [(Topic.DEPTH, b"\0\1\0\0" + bytes(60))])),
    "an event without end": file(recording(EMPTY, [(Topic.EVENTS, b"\0\1\0\0" + b"\xff" * 60)])),
    "a length of 4 GB": file(HEAD + RECORD.pack(Opcode.CHUNK, 2**32 - 1)),
    "a recording without header": file(MAGIC + b"x" * 100),
    "a checkpoint without task": checkpoint({"format": 1, "config": {"model": {}}}),
    "a checkpoint of format 99": checkpoint(STATE | {"format": 99}),
    "a checkpoint of text for numbers": checkpoint(model_of() | {"steps": "many"}),
    "a checkpoint of history 1e9": checkpoint(model_of(history=10**9)),
    "a checkpoint of hidden abc": checkpoint(model_of(hidden="abc")),
    "a checkpoint that is a list": checkpoint("[]"),
    "a deep checkpoint": checkpoint("[" * 1_000_000),
    "a checkpoint of pipes": checkpoint(model_of(), os.mkfifo),
    "tensors of 1 GB on paper": checkpoint(
        model_of(), claims(8 + len(TENSOR) + 1_000_000_000, TENSOR)
    ),
    "tensors of holes": holes,
    "a header of 1 GB on paper": checkpoint(model_of(), claims(1_000_000_000, b"")),
    "results in a pipe": results(os.mkfifo),
    "results of a list": results(lambda p: p.write_text("[]")),
    "results of nothing": results(lambda p: p.write_text("{}")),
    "results of 4 GB on paper": results(lambda p: (p.touch(), os.truncate(p, 4_000_000_000))),
    "results of text": results(
        lambda p: p.write_text('{"runs": [1], "settings": 2, "provenance": "x", "study": []}')
    ),
    "a billion bodies": scene("", '<replicate count="1000000000"><geom size="1"/></replicate>'),
    "a height field of 60,000 squared": scene(
        '<hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/>',
        '<geom type="hfield" hfield="h"/>',
    ),
    "a pipe for a texture": scene(
        '<texture type="2d" name="t" file="pipe.png"/><material name="m" texture="t"/>',
        '<geom type="plane" size="1 1 1" material="m"/>',
    ),
    "a file of the system": scene("", '<include file="/etc/passwd"/>'),
    "a spring that hangs MuJoCo": scene(
        "",
        '<geom type="plane" size="9 9 1"/><body><joint stiffness="-1e12"/><geom size=".1"/></body>',
    ),
}
