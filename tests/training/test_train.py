"""What `renet train` does around the loop: folders, settings, devices, and going on."""

import json
import math
import os
import re
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import tyro

from renet.errors import RenetError
from renet.tasks.sensors import depth_camera
from renet.training import checkpoint as checkpoints
from renet.training import train as training
from renet.training.checkpoint import Checkpoint
from renet.training.config import NP3OCfg, SupervisionCfg, value_at
from renet.training.recipe import RENET
from renet.training.train import TrainCfg, new_run, resolve_device, resumed_run, task_cfg, train

SHIPPED = Path(training.__file__).parents[1] / "pretrained" / "checkpoint"


def cfg(folder: Path, task: str = "Renet-Go1-Flat", **overrides) -> TrainCfg:
    small = {"num_envs": 4, "device": "cpu", "num_steps_per_env": 5, "log_root": folder}
    return TrainCfg(task=task, **(small | {"max_iterations": 1} | overrides))


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """A run of one iteration, to go on from but not to write in."""
    weights = (("collision", -3.0),)
    folder = tmp_path_factory.mktemp("logs")
    run = train(cfg(folder, reward_weights=weights, supervision=SupervisionCfg(5e-4)))
    assert run is not None
    return run


def contents(run: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in run.rglob("*")}


def test_another_task_or_log_root_leaves_the_run_it_goes_on_from_alone(finished, tmp_path, capsys):
    before, root = contents(finished), finished.parent.parent
    checkpoint = finished / "checkpoints" / "it_00000001"
    assert resumed_run(checkpoint, root) == resumed_run(checkpoint, None) == finished
    assert resumed_run(checkpoint, tmp_path) is None
    parkour = train(cfg(tmp_path, "Renet-Go1-Parkour", resume=str(finished), max_iterations=2))
    assert parkour is not None
    assert parkour.parent == tmp_path / "Renet-Go1-Parkour"
    assert f"Going on from {checkpoint}" in capsys.readouterr().out
    assert contents(finished) == before
    assert checkpoints.find(parkour).name == "it_00000002"
    with pytest.raises(RenetError, match="is at iteration 2: --max-iterations counts from"):
        train(cfg(tmp_path, "Renet-Go1-Parkour", resume="latest", max_iterations=2))


def test_an_older_checkpoint_of_a_run_branches_off(tmp_path):
    folder = tmp_path / "task" / "run" / "checkpoints"
    old, new = (checkpoints.save(Checkpoint({}, {}, {}), folder, it, keep=9) for it in (5, 9))
    assert resumed_run(old, None) is None
    assert resumed_run(new, None) == folder.parent


def test_standing_is_asked_for_after_so_many_steps_however_many_robots(tmp_path):
    resumed = Checkpoint({}, {}, {"common_step_counter": torch.tensor(5000)}, {"steps": 1e6})
    runs = [(4e6, None), (math.inf, None), (4e6, resumed)]
    fresh = cfg(tmp_path, "Renet-Go1-Parkour", num_envs=500)
    tasks = [task_cfg(replace(fresh, standing_after=steps), run) for steps, run in runs]
    switches = [task.curriculum["command_stage"].params["switch_step"] for task in tasks]
    assert switches == [8000, math.inf, 5000 + 6000]


def test_a_run_that_goes_on_needs_no_option_repeated_and_says_what_changed(
    finished, tmp_path, capsys, monkeypatch
):
    run = shutil.copytree(finished, tmp_path / "logs" / "Renet-Go1-Flat" / finished.name)
    line = ["Renet-Go1-Flat", "--resume", str(run), "--seed=3", "--randomization.camera-delay=0.2"]
    again = tyro.cli(TrainCfg, args=line, default=TrainCfg.defaults(line))
    assert again.num_envs == 4
    assert again.reward_weights == (("collision", -3.0),)
    assert again.supervision.learning_rate == 5e-4
    learn, given = training.RenetRunner.learn, []
    monkeypatch.setattr(
        training.RenetRunner,
        "learn",
        lambda self, n, time_budget_s: given.append(time_budget_s) or learn(self, n),
    )
    capsys.readouterr()
    assert train(replace(again, max_iterations=2, time_budget="60s")) == run
    out = capsys.readouterr().out.splitlines()
    assert "config.seed was 1, now 3" in out
    assert "task_cfg.scene.sensors.depth_camera.delay was [0.0, 0.1], now [0.0, 0.2]" in out
    assert sum(" was " in row for row in out) == 4  # Its setting, and the number of iterations.
    ours = re.compile(r"Going on|config|task_cfg|Training|Curves|Results|2/2  ")
    assert all(map(ours.match, out)), "no library says anything"
    assert 0.0 < given[0] < 59.9, "the time budget counts from the start"


def test_presets_are_what_a_command_line_starts_from():
    paper = TrainCfg.defaults(["Renet-Go1-Parkour", "--preset=paper"])
    assert (paper.algorithm, paper.supervision) == (NP3OCfg(), SupervisionCfg())
    task = task_cfg(paper)
    assert task.rewards["collision"].weight == -10.0
    assert task.rewards["foot_clearance"].weight == 0.0
    recipe = TrainCfg.defaults(["Renet-Go1-Parkour"])
    assert recipe.supervision.num_mini_batches == 12
    assert value_at(recipe.supervision.learning_rate, 150e6) == 3e-4
    ours = task_cfg(recipe)
    assert depth_camera(ours).noise.gaussian_std == 0.03
    assert ours.rewards["collision"].weight == value_at(RENET["reward_weights"]["collision"], 0.0)
    own = replace(TrainCfg(task="Renet-Go1-Parkour"), reward_weights=(("collision", -2.0),))
    assert task_cfg(own).rewards["collision"].weight == -2.0
    assert task_cfg(own).rewards["foot_clearance"] == ours.rewards["foot_clearance"]


def test_a_rewards_weight_follows_its_schedule_of_environment_steps():
    weights = (("yaw", "1@1M,3@2M"), ("collision", -2.0))
    task = task_cfg(TrainCfg(task="Renet-Go1-Parkour", num_envs=100, reward_weights=weights))
    assert task.rewards["yaw"].weight == 1.0
    term = task.curriculum["yaw_weight"]
    assert term.params["points"] == [(10_000, 1.0), (20_000, 3.0)]
    assert "collision_weight" not in task.curriculum
    manager = SimpleNamespace(get_term_cfg=lambda name: task.rewards[name])
    for step, weight in ((0, 1.0), (15_000, 2.0), (90_000, 3.0)):
        env = SimpleNamespace(common_step_counter=step, reward_manager=manager)
        assert term.func(env, None, **term.params) == weight
        assert task.rewards["yaw"].weight == weight


def test_a_checkpoint_of_settings_that_are_no_more_goes_on_without_them(finished, tmp_path, capsys):
    run = shutil.copytree(finished, tmp_path / "logs" / "Renet-Go1-Flat" / finished.name)
    file = run / "checkpoints" / "it_00000001" / "state.json"
    state = json.loads(file.read_text())
    state["config"] |= {"processes": 2, "hosts": ["first", "second"]}
    file.write_text(json.dumps(state))
    line = ["Renet-Go1-Flat", "--resume", str(run), "--max-iterations", "2"]
    assert train(tyro.cli(TrainCfg, args=line, default=TrainCfg.defaults(line))) == run
    assert "absent" not in capsys.readouterr().out
    found = checkpoints.load_state(checkpoints.find(run))
    assert found["iteration"] == 2
    assert not {"processes", "hosts"} & set(found["config"])


def test_the_shipped_checkpoints_settings_are_read():
    state = checkpoints.load_state(checkpoints.find(SHIPPED))
    own = training.restored(state)
    assert (own.task, own.seed) == (state["task"], state["config"]["seed"])
    assert asdict(own.supervision).items() >= state["config"]["supervision"].items()


@pytest.mark.xfail(strict=True, reason="it learned before images were withheld; the next trains")
def test_the_shipped_checkpoint_states_the_recipe():
    own = training.restored(checkpoints.load_state(checkpoints.find(SHIPPED)))
    recipe = TrainCfg.defaults([own.task])
    size = {"num_envs": own.num_envs, "max_iterations": own.max_iterations, "seed": own.seed}
    assert own == replace(recipe, **size)


def test_runs_begun_in_the_same_second_have_folders_of_their_own(tmp_path):
    assert len({new_run(tmp_path, "task") for _ in range(3)}) == 3


def test_a_process_gets_its_own_gpu_or_is_told(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert resolve_device("auto") == resolve_device("cuda") == "cuda:1"
    monkeypatch.setenv("LOCAL_RANK", "2")
    with pytest.raises(RenetError, match="cuda:2 is absent: 2 CUDA devices"):
        resolve_device("auto")


def test_the_newest_checkpoint_is_the_highest_iteration_of_the_last_run(tmp_path, capsys):
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
