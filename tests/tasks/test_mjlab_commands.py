"""mjlab finds the tasks by itself, and its own commands run them, with nothing of `renet`'s."""

import mjlab.scripts.play as play
import mjlab.scripts.train as train
import numpy as np
import pytest
from mjlab.viewer import NativeMujocoViewer

from renet.curves import CURVES, read_curves
from renet.sim.native.engine import use_engine
from renet.training.checkpoint import load_checkpoint

from ..forked import fork

TASK = "Renet-Go1-Parkour"


def test_train_takes_two_iterations_and_goes_on(tmp_path, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    options = ["--env.scene.num-envs", "4", "--agent.max-iterations", "2", "--gpu-ids", "None"]
    options += ["--agent.num-steps-per-env", "5", "--log-root", str(tmp_path)]
    with use_engine("native", "cpu"):
        for more in ([], ["--agent.resume", "True"]):
            monkeypatch.setattr("sys.argv", ["train", TASK, *options, *more])
            train.main()
    first, second = sorted(tmp_path.glob(f"{TASK}/*"))
    assert [path.name for path in first.glob("checkpoints/*")] == ["it_00000002"]
    end = load_checkpoint(next(second.glob("checkpoints/*")))
    assert (end.state["iteration"], end.state["steps"], end.state["task"]) == (
        4,
        4 * 4 * 5,
        TASK,
    )
    assert end.environment["common_step_counter"] == 4 * 5
    assert len(end.environment["levels"]) == 4
    for curve in read_curves(first / CURVES).values():
        assert curve.keys() <= {0, 1}
        assert np.isfinite([*curve.values()]).all()


@pytest.mark.parametrize("task", ["Renet-Go1-Flat", "Renet-Go1-Parkour"])
def test_play_steps_a_policy_of_zeros(task, monkeypatch):
    steps = []

    def run(viewer: NativeMujocoViewer) -> None:
        for _ in range(3):
            observation = viewer.env.get_observations()
            steps.append(viewer.env.step(viewer.policy(observation)))

    monkeypatch.setattr(NativeMujocoViewer, "run", run)
    options = ["--agent", "zero", "--viewer", "native", "--num-envs", "2", "--device", "cpu"]
    monkeypatch.setattr("sys.argv", ["play", task, *options])
    with use_engine("native", "cpu"):  # MuJoCo Warp compiles a height field for minutes.
        play.main()
    assert len(steps) == 3
    assert all(reward.shape == (2,) for _, reward, *_ in steps)


def start(first: str) -> None:
    exec(f"import {first}")
    import mjlab.tasks  # noqa: F401
    from mjlab.tasks.registry import list_tasks

    from renet.tasks import make_env

    kinds = ("Flat", "Parkour", "Parkour-Paper")
    names = {f"Renet-{robot}-{kind}" for robot in ("Go1", "Go2") for kind in kinds}
    assert {task for task in list_tasks() if "Renet" in task} == names
    env = make_env("Renet-Go1-Parkour", 2)
    env.reset()
    env.step(env.action_manager.action)


@pytest.mark.parametrize(
    "first",
    ["mjlab.tasks", "renet.sim.depth.camera", "renet.training.config", "torch, warp, renet.tasks"],
)
def test_tasks_register_in_any_import_order(first):
    """Neither does Warp tell that it starts, has no GPU, or which modules it loads."""
    done = fork(start, first)
    assert done.returncode == 0, done.stderr
    for chatter in ("Failed to load", "Warp", "load on device", "CUDA"):
        assert chatter not in done.stdout + done.stderr
