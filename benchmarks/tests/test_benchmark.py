"""The script that walks the whole fault benchmark, with programs that only note their calls."""

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "benchmark.sh"
MODELS = ("go1_policy.onnx", "himloco.pt", "go2_moe_cts_124k.pt", "robot_lab.pt")


@pytest.fixture
def walk(tmp_path):
    """Function that runs the script with a folder of models; returns the end and the calls."""
    programs = tmp_path / "programs"
    programs.mkdir()
    log = tmp_path / "calls"
    log.touch()
    for name in ("renet", "python", "cp", "mkdir"):
        program = programs / name
        program.write_text(f'#!/bin/sh\necho {name} "$@" >> {log}\n')
        program.chmod(0o755)
    environment = os.environ | {"PATH": f"{programs}:{os.environ['PATH']}"}

    def run(*arguments: str):
        command = ["bash", str(SCRIPT), *arguments]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        return done, log.read_text().splitlines()

    (tmp_path / "models").mkdir()
    for name in MODELS:
        (tmp_path / "models" / name).touch()
    return run


def test_models_are_found_from_wherever_the_script_is_started(walk, tmp_path):
    done, calls = walk("models")
    assert done.returncode == 0
    policies = [call.split("--policy ")[1].split()[0] for call in calls if "--policy" in call]
    assert policies == [str(tmp_path / "models" / name) for name in MODELS]


def test_a_missing_model_is_told_before_anybody_walks(walk, tmp_path):
    (tmp_path / "models" / "robot_lab.pt").unlink()
    done, calls = walk("models")
    assert done.returncode == 2
    assert done.stderr == f"benchmark.sh: there is no {tmp_path}/models/robot_lab.pt\n"
    assert calls == []
