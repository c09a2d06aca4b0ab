"""The needs of a robot's computer: NumPy, ONNX Runtime, MCAP, msgspec, tyro and rich alone."""

import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import renet
from renet.bundle import DEFAULT, pretrained

TRAINING = ("torch", "mjlab", "warp", "mujoco", "mujoco_warp", "rsl_rl", "matplotlib", "mediapy")
ELSEWHERE = ("renet.deploy.robots.sim.", "renet.deploy.cameras.sim", "renet.deploy.robots.go2.fake")
"""Beginnings of modules that are the simulated robot, imported when it is asked for."""
if find_spec("cyclonedds") is None:  # Needs renet-locomotion[go2].
    ELSEWHERE += ("renet.deploy.dds.", "renet.deploy.robots.go2.", "renet.deploy.teleop.ros2")


def modules() -> list[str]:
    """Everything a robot runs."""
    root = Path(renet.__file__).parents[1]
    parts = ("deploy", "pilot", "selector")
    files = [file for part in parts for file in (root / "renet" / part).rglob("*.py")]
    paths = [".".join(file.relative_to(root).with_suffix("").parts) for file in files]
    names = [path.removesuffix(".__init__") for path in paths]
    names += ["renet.cli", "renet.evaluation.calibrate"]
    return sorted(name for name in names if not name.startswith(ELSEWHERE))


BLOCK = f"""
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {TRAINING}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
"""


def without_training_packages(code: str) -> subprocess.CompletedProcess[str]:
    """Run Python as if they were not installed."""
    return subprocess.run([sys.executable, "-c", BLOCK + code], capture_output=True, text=True)


def test_the_runtime_imports_without_training_packages():
    assert len(modules()) > 30
    done = without_training_packages("\n".join(f"import {name}" for name in modules()))
    assert done.returncode == 0, done.stderr


def test_logs_are_scored_replayed_and_calibrated_from_without_them(log, tmp_path):
    shipped = str(pretrained(DEFAULT))
    commands = [
        ["evaluate", "log", str(log), "--out", str(tmp_path / "score"), "--replay", shipped],
        ["bundle", "inspect", shipped],
        ["bundle", "card", shipped, "--out", str(tmp_path / "card")],
        ["calibrate", str(tmp_path / "bundle"), "--log", str(log)],
    ]
    shutil.copytree(shipped, tmp_path / "bundle")
    code = "import renet.deploy.recording.calibration_log as log; log.MIN_MINUTES = 0.0\n"
    code += f"from renet.cli import main; assert all(main(c) == 0 for c in {commands})"
    done = without_training_packages(code)
    assert done.returncode == 0, done.stderr
    assert "commands differ by at most 0 rad" in done.stdout
    assert "the timeline needs matplotlib: in a clone of renet, run pip install" in done.stdout
    assert (tmp_path / "score" / "score.json").exists()
    assert "beta" in done.stdout


@pytest.mark.parametrize(
    ("command", "hint"),
    [
        (["calibrate", "x"], "pip install -c requirements-lock.txt -e '.[train]'"),
        (["play"], "pip install -c requirements-lock.txt -e '.[train]'"),
        (["deploy"], "`renet deploy` needs mujoco: in a clone of renet, run pip install"),
    ],
)
def test_what_needs_more_says_what_to_install(command, hint):
    done = without_training_packages(f"from renet.cli import main; sys.exit(main({command}))")
    assert done.returncode == 2
    assert hint in done.stderr
    assert "Traceback" not in done.stderr
