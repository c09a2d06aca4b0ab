"""Users' mistakes: each ends in one line that names what is wrong, and the way out."""

import errno
import os
import re
import shutil
import socket
from pathlib import Path

import numpy as np
import pytest

from renet import cli
from renet.bundle import SHIPPED, pretrained
from renet.errors import obstacle
from renet.page.writer import WEB

WALK = ("deploy", "--camera", "sim", "--seconds", "0.1")
SCENE = (*WALK, "--scene")
REPLAY = ("deploy", "--camera", "replay", "--recording")
FLAT = ("train", "Renet-Go1-Flat")
TRAIN = (*FLAT, "--config")
SHIPS = "go1-parkour or go1-driven or go2-parkour or go2-driven, which ship"

MISTAKES: dict[tuple[str, ...], tuple[str, str]] = {
    # Names: the nearest ones, or all.
    ("deplyo",): ("deplyo", "did you mean deploy?"),
    ("evaluate", "fautls"): ("unknown command `renet evaluate` 'fautls'", "did you mean faults?"),
    ("bundle", "x"): ("unknown command `renet bundle` 'x'", "choose one of inspect, card"),
    ("deploy", "nowhere"): ("nowhere", SHIPS),
    ("deploy", "go1-parkuor"): ("go1-parkuor", "did you mean go1-parkour or go2-parkour"),
    (*WALK, "--fault", "blakout"): ("blakout", "did you mean blackout?"),
    (*WALK, "--fault", "blakout@soon"): ("blakout", "did you mean blackout?"),
    (*WALK, "--fault", "blackout@soon"): ("blackout@soon", "such as blackout@5s"),
    (*WALK, "--fault", "blackout:9@1s"): ("severity 9", "choose 1 to 5"),
    (*WALK, "--terrain", "gpa"): ("--terrain 'gpa'", "stairs_down, gap, platform"),
    (*WALK, "--terrain=platfrom"): ("--terrain 'platfrom'", "did you mean platform?"),
    (*WALK, "--mode", "memry"): ("--mode 'memry'", "did you mean memory?"),
    (*WALK, "--unseen", "run"): ("--unseen 'run'", "choose one of walk, slow, stop"),
    (*WALK, "--motors", "idael"): ("idael", "must be ideal, go1 or a file of `renet identify`"),
    ("deploy", "--robot", "go3"): ("go3", "choose one of mujoco, go1, go2"),
    ("deploy", "--camera", "realsens"): ("realsens", "did you mean realsense?"),
    ("train", "Renet-Go1-Parkuor"): ("Renet-Go1-Parkuor", "did you mean Renet-Go1-Parkour"),
    (*FLAT, "--device", "cuda:7"): ("device cuda:7 is absent", "CUDA devices"),
    ("identify", "odd.csv", "--robot", "go5"): ("go5", "choose one of Unitree Go1, Unitree Go2"),
    # Bundles, recordings, configurations and results that are none.
    ("bundle", "inspect", "file"): ("file", SHIPS),
    ("bundle", "inspect", "x" * 300): ("File name too long", "give a shorter path"),
    ("export", "nowhere"): ("no checkpoint at", "nowhere"),
    ("bundle", "inspect", "folder"): ("folder is no bundle, without manifest.json", SHIPS),
    ("bundle", "inspect", "damaged"): ("manifest.json is not JSON", "line 1 column 2"),
    (*REPLAY, "nowhere"): ("recording nowhere", "give the path of one that exists"),
    (*REPLAY, "folder"): ("recording folder is not a regular file", "give a file"),
    ("evaluate", "log", "walk.mcpa"): ("recording walk.mcpa", "did you mean walk.mcap?"),
    ("evaluate", "log", "fodler/a.mcap"): ("fodler/a.mcap", "did you mean folder?"),
    ("evaluate", "log", "file/a.mcap"): ("file/a.mcap", "file is a file; give another path"),
    ("evaluate", "log", "file"): ("file is not a recording", "`renet deploy`"),
    ("evaluate", "log", "x" * 300): ("File name too long", "give a shorter path"),
    ("identify", "nowhere", "--robot", "go1"): ("log nowhere", "give the path of one that exists"),
    ("identify", "folder", "--robot", "go1"): ("log folder", "give a file"),
    (*TRAIN, "nowhere.yaml"): ("nowhere.yaml", "give the path of one that exists"),
    (*TRAIN, "file"): ("file is no configuration", "give a .json, .yaml or .yml file"),
    (*TRAIN, "odd.yaml"): ("odd.yaml is no YAML", "line 1, column 5"),
    (*TRAIN, "list.yaml"): ("list.yaml must map names to values", "as in `agent:`"),
    # Height maps.
    (*SCENE, "nowhere.npy"): ("nowhere.npy", "give the path of one that exists"),
    (*SCENE, "folder"): ("folder is not a regular file but a folder", "give a file"),
    (*SCENE, "cube.npy"): ("cube.npy has the shape (3, 3, 3)", "give rows and columns"),
    (*SCENE, "hole.npy"): ("hole.npy holds values that are not finite", "numpy.nan_to_num"),
    (*SCENE, "words.npy"): ("words.npy must hold numbers", "save heights in m as floats"),
    (*SCENE, "odd.npy"): ("odd.npy is no .npy of numbers", "numpy.save"),
    (*SCENE, "odd.png"): ("odd.png is no .png", "save the picture as PNG"),
    (*SCENE, "odd.xml"): ("odd.xml: XML parse error", "give MJCF that MuJoCo loads"),
    # Where nothing can be written.
    (*WALK, "--out", "file"): ("cannot write to file", "file is a file; give another path"),
    (*WALK, "--out", "file/a"): ("cannot write to file/a", "file is a file; give another path"),
    ("train", "Renet-Go1-Flat", "--log-root", "file"): (
        "to file: Not a directory",
        "Choose another",
    ),
    ("page", "--out", "file"): ("file exists and is not a page", "choose another folder"),
}
"""Words that name what is wrong, and words that say what to do, by command line."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Files of which each has something wrong."""
    folder = tmp_path_factory.mktemp("mistakes")
    for name in ("file", "odd.png", "odd.npy", "odd.xml", "walk.mcap"):
        (folder / name).write_text("x")
    (folder / "folder").mkdir()
    (folder / "odd.csv").write_text("a,b\n1,2\n")
    (folder / "odd.yaml").write_text("a: [")
    (folder / "list.yaml").write_text("- a")
    hole = np.zeros((3, 3))
    hole[1, 1] = np.nan
    for name, array in (("cube", np.zeros((3, 3, 3))), ("hole", hole), ("words", ["a", "b"])):
        np.save(folder / f"{name}.npy", np.asarray(array))
    shutil.copytree(pretrained(SHIPPED[0]), folder / "damaged")
    (folder / "damaged" / "manifest.json").write_text("{")
    return folder


def line(capsys, *arguments: str) -> str:
    """The one line in which a mistake ends."""
    code = cli.main(list(arguments))
    error = capsys.readouterr().err
    (line,) = error.splitlines()
    assert code == 2
    assert line.startswith("renet: ")
    assert not re.search(r"Errno|Traceback", line)
    return line


def demand_packages() -> None:
    """Skip a test of the page where its npm packages are missing, which it is told first."""
    if not (WEB / "node_modules" / "three").is_dir():
        pytest.skip(f"the page's npm packages are missing: npm ci --prefix {WEB}")


@pytest.mark.parametrize("arguments", MISTAKES, ids=" ".join)
def test_a_mistake_is_named_with_the_way_out(folder, monkeypatch, capsys, arguments):
    if arguments[0] == "page":
        demand_packages()
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    said = line(capsys, *arguments)
    for words in MISTAKES[arguments]:
        assert words in said
    assert sorted(folder.iterdir()) == before, "nothing is left behind"


def test_a_port_in_use_is_named_with_another_one(tmp_path, capsys):
    demand_packages()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        said = line(capsys, "page", "--out", str(tmp_path / "page"), "--open", "--port", port)
    assert f"cannot serve on port {port}: Address already in use; give another --port" in said


@pytest.mark.parametrize(
    ("number", "way"),
    [
        (errno.EACCES, "Permission denied: change its permissions, or give another path"),
        (errno.ENOSPC, "No space left on device: free the disk, or give another path"),
        (errno.EIO, "Input/output error: give another path"),
    ],
)
def test_errors_of_the_system_have_a_way_out(number, way):
    assert obstacle(OSError(number, os.strerror(number)), Path("a")) == way


def test_the_nearest_path_is_suggested_where_the_first_part_is_missing(tmp_path):
    (tmp_path / "results").mkdir()
    missing = FileNotFoundError(errno.ENOENT, "No such file or directory")
    near = obstacle(missing, tmp_path / "reslts" / "log.mcap")
    assert near.endswith(f"did you mean {tmp_path / 'results'}?")
    assert obstacle(missing, tmp_path / "q").endswith("give the path of one that exists")
    assert obstacle(missing, Path("/" + 300 * "x")).endswith("give the path of one that exists")
