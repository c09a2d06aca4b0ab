"""Registers tasks with mjlab, which loads this module through the `mjlab.tasks` entry point."""

from __future__ import annotations

from mjlab.tasks.registry import register_mjlab_task

from renet.tasks.config.go1 import GO1
from renet.tasks.config.go2 import GO2
from renet.tasks.parkour_env_cfg import flat_env_cfg, parkour_env_cfg
from renet.tasks.robot_cfg import RobotCfg
from renet.training.config import RenetRunnerCfg
from renet.training.runner import RenetRunner


def register_tasks(name: str, robot: RobotCfg) -> None:
    """Give a robot the tasks Renet-`name`-Flat and Renet-`name`-Parkour."""
    for terrain, cfg in (("Flat", flat_env_cfg), ("Parkour", parkour_env_cfg)):
        register_mjlab_task(
            task_id=f"Renet-{name}-{terrain}",
            env_cfg=cfg(robot=robot),
            play_env_cfg=cfg(play=True, robot=robot),
            rl_cfg=RenetRunnerCfg(num_steps_per_env=25),  # As many as mjlab's own, in whole ticks.
            runner_cls=RenetRunner,
        )


register_tasks("Go1", GO1)
register_tasks("Go2", GO2)
