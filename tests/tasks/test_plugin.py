"""mjlab finds the tasks by itself, and starting them says nothing."""

import pytest

from ..forked import fork


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
def test_tasks_are_registered_and_start_silently_whatever_is_imported_first(first):
    """Neither does Warp tell that it starts, has no GPU, or which modules it loads."""
    done = fork(start, first)
    assert done.returncode == 0, done.stderr
    for chatter in ("Failed to load", "Warp", "load on device", "CUDA"):
        assert chatter not in done.stdout + done.stderr
