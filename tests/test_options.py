"""Mistakes that are told, and tasks that are known, without PyTorch."""

import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest

from renet import options, plug_ins
from renet.errors import RenetError
from renet.options import TASK, UsualOptions, check_task

MISTAKES = {
    "train Renet-Go1-Parkur": "unknown task 'Renet-Go1-Parkur': did you mean Renet-Go1-Parkour",
    "recipe --task Renet-Go1-Falt": "unknown task 'Renet-Go1-Falt': did you mean Renet-Go1-Flat",
    "train Renet-Go1-Flat --num-env 8": "unknown option '--num-env': did you mean --num-envs",
    "train Renet-Go1-Flat --time-budget soon": "time budget 'soon' is not a duration",
    "train Renet-Go1-Flat --env.scene.x -3 --device tpu": "unknown device 'tpu'",
    "train Renet-Go1-Flat --num_envs 0": "environments must be at least 1",
    "train Renet-Go1-Flat --seed 20261201030303": "seed must be from 0 to 2^32 - 1, got 20261",
    "train Renet-Go1-Flat --engine steam": "unknown --engine 'steam': choose one of auto, native",
    "train Renet-Go1-Flat --resume nowhere": "nothing to resume: nowhere does not exist",
    "train --resume latest": "write the task first",
    "train --seed 1": "Missing from renet train",
    "train Renet-Go2-Flat --scene ground.npy": "the task has no tiles to put a scene among",
    "train Renet-Go2-Parkour --scene ground.npy": "there is no scene ground.npy",
    "train Renet-Go1-Parkour --scene . --scene-share 2": "--scene-share must be above 0",
}
TELL = """
import sys
from renet import cli
for line in sys.argv[1:]:
    try:
        code = cli.main(line.split())
    except SystemExit as stop:
        code = stop.code
    heavy = {"torch", "mjlab", "warp", "mujoco"} & {*sys.modules}
    print(f"{line}: {code} {sorted(heavy)}")
"""


def test_mistakes_are_told_without_torch_or_mjlab(tmp_path):
    command = [sys.executable, "-c", TELL, *MISTAKES]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=True)
    assert done.stdout.splitlines() == [f"{line}: 2 []" for line in MISTAKES]
    told = " ".join(done.stderr.replace("│", " ").split())
    assert [message for message in MISTAKES.values() if message not in told] == []


@pytest.fixture
def bare(monkeypatch) -> None:
    """As in a process that has not loaded mjlab."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "mjlab"]:
        monkeypatch.delitem(sys.modules, name)


@pytest.mark.usefixtures("bare")
def test_a_task_that_a_plug_in_may_register_is_left_to_it(monkeypatch):
    ours = EntryPoint("renet", plug_ins.REGISTRY, plug_ins.TASKS)
    monkeypatch.setattr(options, "entry_points", lambda group: [ours])
    with pytest.raises(RenetError, match="unknown task 'My-Robot'"):
        check_task("My-Robot")
    check_task("Mjlab-Velocity-Flat-Unitree-Go1")  # Which says what it lacks.
    theirs = EntryPoint("mine", "my_package.tasks", plug_ins.TASKS)
    monkeypatch.setattr(options, "entry_points", lambda group: [ours, theirs])
    check_task("My-Robot")


def test_a_tasks_settings_and_their_values_are_left_to_it():
    settings = ["--agent.seed", "-3", "--env.a=(1,2)", "--env.b", "x"]
    assert UsualOptions.known([TASK, *settings, "--seed", "4"]) == [TASK, "--seed", "4"]
