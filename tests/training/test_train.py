"""What `renet train` does around the loop: folders, settings, devices, stopping and going on."""

import io
import os
import re
import shutil
import signal
import sys
import time
from dataclasses import fields, replace
from pathlib import Path
from unittest.mock import Mock

import mjlab.scripts.train
import pytest
import torch
from mjlab.tasks.registry import list_tasks

from renet import options
from renet.cli import COMMANDS, parse
from renet.errors import RenetError
from renet.folders import lock
from renet.tasks.parkour_env_cfg import parkour_env_cfg
from renet.tasks.sensors import depth_camera
from renet.training import checkpoint as checkpoints
from renet.training import train as training
from renet.training.checkpoint import Checkpoint
from renet.training.config import RenetRunnerCfg
from renet.training.provenance import restore, to_json
from renet.training.runs import new_run, resumed_run, signals
from renet.training.train import TrainCfg, resolve_device, train

from ..forked import fork

SHIPPED = Path(training.__file__).parents[1] / "pretrained" / "checkpoint"
TASK = "Renet-Go1-Parkour"


def cfg(folder: Path, task: str = "Renet-Go1-Flat", **options) -> TrainCfg:
    """A small run in `folder`; `options` are fields of TrainCfg or of its agent."""
    of_run = {f.name for f in fields(TrainCfg)} & options.keys()
    result = TrainCfg.from_task(task, log_root=folder, device="cpu")
    result = replace(result, **{name: options.pop(name) for name in of_run})
    result.env.scene.num_envs = 4
    agent = {"num_steps_per_env": 5, "max_iterations": 1} | options
    return replace(result, agent=replace(result.agent, **agent))


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """A run of one iteration, to go on from but not to write in."""
    small = cfg(tmp_path_factory.mktemp("logs"), average_over=7)
    small.env.rewards["yaw"].weight = 0.25
    return train(small)


def test_another_task_leaves_old_run(finished, tmp_path, capsys):
    before = {path: path.stat().st_mtime_ns for path in finished.rglob("*")}
    checkpoint = finished / "checkpoints" / "it_00000001"
    assert resumed_run(checkpoint, finished.parents[1]) == resumed_run(checkpoint, None) == finished
    assert resumed_run(checkpoint, tmp_path) is None
    parkour = train(cfg(tmp_path, "Renet-Go1-Parkour", resume=str(finished), max_iterations=2))
    assert parkour.parent == tmp_path / "Renet-Go1-Parkour"
    assert f"Going on from {checkpoint}" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in finished.rglob("*")} == before
    assert checkpoints.find(parkour).name == "it_00000002"
    with pytest.raises(RenetError, match="is at iteration 2: --max-iterations counts from"):
        train(cfg(tmp_path, "Renet-Go1-Parkour", resume="latest", max_iterations=2))


def test_latest_is_the_run_whose_settings_are_restored(finished, tmp_path):
    """Not one of another experiment."""
    for experiment in ("Renet-Go1-Flat", "mine"):
        shutil.copytree(finished, tmp_path / experiment / finished.name)
    mine = cfg(tmp_path, resume="latest", experiment_name="mine", max_iterations=2)
    path, _ = training.checkpoint_of(mine)
    assert path.is_relative_to(tmp_path / "Renet-Go1-Flat")


def test_resume_of_mjlab_is_refused(tmp_path):
    small = cfg(tmp_path)
    with pytest.raises(RenetError, match="of mjlab's own train"):
        train(replace(small, agent=replace(small.agent, resume=True)))
    assert not list(tmp_path.iterdir())


def test_older_checkpoint_branches_off(tmp_path):
    folder = tmp_path / "task" / "run" / "checkpoints"
    old, new = (checkpoints.save(Checkpoint({}, {}, {}), folder, it, keep=9) for it in (5, 9))
    assert resumed_run(old, None) is None
    assert resumed_run(new, None) == folder.parent
    assert resumed_run(tmp_path / "checkpoints" / "best", None) is None


@pytest.mark.parametrize("inside", [".", "checkpoints", "checkpoints/it_00000009"])
def test_a_run_goes_on_from_within_its_folder(tmp_path, monkeypatch, inside):
    run = tmp_path / "task" / "run"
    checkpoints.save(Checkpoint({}, {}, {}), run / "checkpoints", 9, keep=9)
    monkeypatch.chdir(run / inside)
    assert resumed_run(checkpoints.find(Path()), None).resolve() == run


def test_resumed_run_keeps_options(finished, tmp_path, capsys, monkeypatch):
    run = shutil.copytree(finished, tmp_path / "logs" / "Renet-Go1-Flat" / finished.name)
    options = ["--seed=3", "--env.scene.sensors.3.delay=(0.0,0.2)", "--max-iterations=2"]
    again = parse(TrainCfg, ["Renet-Go1-Flat", "--resume", str(run), *options], "")
    assert (again.env.scene.num_envs, again.agent.average_over) == (4, 7)
    assert again.env.rewards["yaw"].weight == 0.25
    learn, given = training.RenetRunner.learn, []
    monkeypatch.setattr(
        training.RenetRunner,
        "learn",
        lambda self, n, time_budget_s, **k: given.append(time_budget_s) or learn(self, n, **k),
    )
    capsys.readouterr()
    assert train(replace(again, time_budget="60s")) == run
    out = capsys.readouterr().out.splitlines()
    assert "Each robot takes 5 control steps in an iteration" in out
    assert "agent.seed was 1, now 3" in out
    assert "env.scene.sensors.depth_camera.delay was [0.0, 0.1], now [0.0, 0.2]" in out
    assert sum(" was " in row for row in out) == 3  # And the number of iterations.
    ours = re.compile(r"Going on|agent|env|Training|Each robot|Curves|iteration 2  ")
    assert all(map(ours.match, out)), "no library says anything"
    assert 0.0 < given[0] < 59.9, "the time budget counts from the start"


def test_a_time_budget_that_loading_has_used_up_ends_the_run_and_says_so(tmp_path, capsys):
    late = cfg(tmp_path, time_budget="60s", max_iterations=50)
    run = train(late, started=time.monotonic() - 100.0)
    (only,) = checkpoints.checkpoints(run / "checkpoints")
    assert only.name == "it_00000001", "one iteration is always done"
    (line,) = [row for row in capsys.readouterr().out.splitlines() if "time budget" in row]
    assert re.match(r"Ended after 1\d\d s of the time budget of 60s: a further iteration", line)
    assert f"--resume {run}" in line


@pytest.mark.parametrize(
    ("robots", "fixed", "line"),
    [
        (512, None, "25 control steps in an iteration, later 100"),
        (4096, None, "25 control steps in an iteration"),
        (512, 1000, "1,000 control steps in an iteration"),
        (3, None, "1,000 control steps in an iteration, the most there are: take more robots"),
        (50, None, "260 control steps in an iteration, later 1,000, the most there are: take more"),
    ],
)
def test_iterations_are_described(robots, fixed, line):
    agent = replace(TrainCfg.from_task(TASK).agent, num_steps_per_env=fixed)
    said = training.describe_iterations(agent, robots, 0)
    assert said.startswith(f"Each robot takes {line}")
    assert ("the most" in said) == ("the most" in line)


def whole(cfg) -> dict:
    """Both configurations, as JSON."""
    return {"env": to_json(cfg.env), "agent": to_json(cfg.agent)}


OPTIONS = ("--env.rewards.yaw.weight", "0.3", "--agent.model.him", "False", "--seed", "4")


@pytest.mark.parametrize(
    ("task", "options"),
    [(TASK, ()), (TASK, OPTIONS), (f"{TASK}-Paper", ()), ("Renet-Go1-Flat", OPTIONS)],
)
def test_mjlabs_train_begins_with_the_same_settings(task, options, monkeypatch):
    taken = []
    monkeypatch.setattr(mjlab.scripts.train, "launch_training", lambda **k: taken.append(k["args"]))
    monkeypatch.setattr("sys.argv", ["train", task, *options])
    mjlab.scripts.train.main()
    ours = parse(TrainCfg, [task, *options], "")
    assert whole(ours) == whole(taken.pop())
    changed = ours.env.rewards["yaw"].weight, ours.agent.model.him, ours.agent.seed
    assert changed == ((0.3, False, 4) if options else (0.5, True, 1))


def print_tasks() -> None:
    print(*(task for task in list_tasks() if task.startswith("Renet-")))


def test_options_match_registered_tasks():
    # In a process of its own: other tests register tasks.
    assert fork(print_tasks).stdout.split() == sorted(options.TASKS)
    usual = options.UsualOptions(task=TASK)
    agent = TrainCfg.from_task(TASK).agent
    assert (usual.seed, usual.max_iterations) == (agent.seed, agent.max_iterations)


def test_full_help_lists_task_settings(capsys):
    run, config, arguments = COMMANDS["train"].load([TASK, "--help-all"])
    assert run is training.train_command
    with pytest.raises(SystemExit, match="0"):
        parse(config, arguments, "renet train")
    assert "--env.rewards.yaw.weight" in capsys.readouterr().out


def test_paper_task_lacks_recipe():
    paper = TrainCfg.from_task(f"{TASK}-Paper")
    assert paper.agent == RenetRunnerCfg(task=paper.task, experiment_name=paper.task)
    rules = to_json(parkour_env_cfg())
    rules["scene"]["num_envs"] = paper.env.scene.num_envs
    assert to_json(paper.env) == rules
    assert paper.env.rewards["collision"].weight == -10.0
    assert paper.env.curriculum["command_stage"].params == {"after": 4e8}
    assert depth_camera(paper.env).noise.gaussian_std == 0.1


def test_settings_come_back_from_their_description():
    """All that is plain; functions stay as the code has them."""
    ours = TrainCfg.from_task(TASK)
    ours.env.rewards["yaw"].weight, ours.env.commands["goal"].speed = 3.0, (0.1, 0.7)
    ours.env.scene.terrain.terrain_generator.sub_terrains["platform"].rings = ((1.0, 2.0),)
    ours.agent.algorithm.cost_budget = (1.0, "2@3M,4@5M", 6.0)
    stored = whole(ours)
    registered = TrainCfg.from_task(TASK)
    assert whole(registered) != stored
    env, agent = (
        restore(getattr(registered, name), stored[name], name) for name in ("env", "agent")
    )
    back = replace(registered, env=env, agent=agent)
    assert whole(back) == stored
    assert back.agent == ours.agent
    assert back.env.commands["goal"] == ours.env.commands["goal"]
    # What the code has no more, or has anew, does not matter.
    stored["env"]["rewards"]["lift"] = {"weight": 1.0}
    del stored["env"]["scene"]
    assert (
        restore(registered.env, stored["env"], "env").rewards.keys()
        == registered.env.rewards.keys()
    )


@pytest.mark.parametrize("before", [["--num-envs", "8"], ["--num_envs=8"], ["--seed", "-1"]])
def test_settings_are_those_of_a_task_after_options(before):
    flat = parse(TrainCfg, [*before, "Renet-Go1-Flat", "--max-iterations", "3"], "")
    assert flat.task == flat.agent.task == flat.agent.experiment_name == "Renet-Go1-Flat"
    assert flat.env.scene.terrain.terrain_type == "plane"
    assert flat.agent.max_iterations == 3


def test_a_task_after_a_setting_is_told_to_come_first(finished):
    late = ["--resume", str(finished), "--agent.average-over", "3", "Renet-Go1-Parkour"]
    mixed = parse(TrainCfg, late, "")
    with pytest.raises(RenetError, match="write the task first: renet train Renet-Go1-Parkour"):
        training.train_command(mixed)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signal_stops_with_checkpoint(tmp_path, capsys, monkeypatch, number):
    act, steps = training.RenetRunner._iterate, []

    def iterate(self, *args):
        steps.append(1)
        if len(steps) == 2:
            os.kill(os.getpid(), number)
            # A terminal that closes may tell twice, also after Ctrl-C.
            os.kill(os.getpid(), signal.SIGHUP)
        return act(self, *args)

    monkeypatch.setattr(training.RenetRunner, "_iterate", iterate)
    before = signal.getsignal(number)
    with pytest.raises(SystemExit) as stopped:
        train(cfg(tmp_path, max_iterations=1000))
    assert stopped.value.code == 128 + number
    assert signal.getsignal(number) is before
    newest = checkpoints.find(tmp_path)
    assert newest.name == "it_00000001"
    run = newest.parents[1]
    said = f"Stopped at {newest}: renet train Renet-Go1-Flat --resume {run} goes on"
    assert said in capsys.readouterr().out.splitlines()


def test_a_run_below_nohup_outlives_its_terminal():
    heard = []
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with signals(heard.append):
            os.kill(os.getpid(), signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    assert heard == []


def test_a_signal_that_ends_the_reader_too_leaves_a_checkpoint(tmp_path, monkeypatch):
    """As Ctrl-C does with `renet train | tee LOG`."""
    act, steps = training.RenetRunner._iterate, []

    def iterate(self, *args):
        steps.append(1)
        if len(steps) == 2:
            monkeypatch.setattr(shown, "write", Mock(side_effect=BrokenPipeError))
            os.kill(os.getpid(), signal.SIGINT)
        return act(self, *args)

    shown = io.StringIO()
    monkeypatch.setattr(sys, "stdout", shown)
    monkeypatch.setattr(training.RenetRunner, "_iterate", iterate)
    with pytest.raises(SystemExit) as stopped:
        train(cfg(tmp_path, max_iterations=1000))
    assert stopped.value.code == 128 + signal.SIGINT
    assert checkpoints.find(tmp_path).name == "it_00000001"


def test_second_signal_interrupts_at_once(tmp_path, monkeypatch):
    def twice(self, *args):
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(training.RenetRunner, "_iterate", twice)
    with pytest.raises(KeyboardInterrupt):
        train(cfg(tmp_path))
    assert not list(tmp_path.rglob("it_*"))
    monkeypatch.setattr(
        training, "make_vec_env", lambda *_: os.kill(os.getpid(), signal.SIGTERM) or 1 / 0
    )
    with pytest.raises(KeyboardInterrupt):
        train(cfg(tmp_path / "other"))
    assert not (tmp_path / "other").exists()


def test_running_run_is_not_resumed(finished, tmp_path):
    run = shutil.copytree(finished, tmp_path / "Renet-Go1-Flat" / finished.name)
    with lock(run), pytest.raises(RenetError, match=f"another program writes to {run}"):
        train(cfg(tmp_path, resume=str(run), max_iterations=2))


def test_a_task_of_another_package_is_refused():
    with pytest.raises(RenetError, match="is not a RENet task"):
        parse(TrainCfg, ["Mjlab-Velocity-Flat-Unitree-Go1"], "")


def test_runs_of_one_second_differ(tmp_path):
    assert len({new_run(tmp_path, "task", "mine") for _ in range(3)}) == 3
    assert all("_mine" in run.name for run in (tmp_path / "task").iterdir())


@pytest.mark.parametrize("name", ["../../elsewhere", "a/b", "\x1b]0;owned\x07", "a\0b"])
def test_run_name_is_no_path(tmp_path, name):
    with pytest.raises(RenetError, match=r"agent.run-name must be no path"):
        new_run(tmp_path / "logs", "task", name)
    assert list(tmp_path.iterdir()) == []


def test_process_gets_its_own_gpu(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert resolve_device("auto") == resolve_device("cuda") == "cuda:1"
    monkeypatch.setenv("LOCAL_RANK", "2")
    with pytest.raises(RenetError, match="cuda:2 is absent: 2 CUDA devices"):
        resolve_device("auto")


def test_newest_checkpoint_by_run_and_iteration(tmp_path, capsys):
    """Not the file touched last: copying or syncing a run touches them in any order."""
    names = ("2026-01-01_10-00-00", 9), ("2026-01-02_10-00-00", 3), ("2026-01-02_10-00-00", 12)
    for age, (run, iteration) in enumerate(names):
        folder = tmp_path / run / "checkpoints" / f"it_{iteration:08d}"
        folder.mkdir(parents=True)
        (folder / "state.json").write_text("{}")
        os.utime(folder, (1000 - age, 1000 - age))
    (tmp_path / "2026-01-03" / "it_final").mkdir(parents=True)
    (tmp_path / "2026-01-03" / "it_final" / "state.json").write_text("{}")
    found = checkpoints.find(tmp_path)
    assert (found.parent.parent.name, found.name) == ("2026-01-02_10-00-00", "it_00000012")
    assert f"Checkpoint: {found}\n" == capsys.readouterr().err
