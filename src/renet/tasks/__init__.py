"""What the robot is asked to do. mjlab finds these tasks through the `mjlab.tasks` entry point."""

from __future__ import annotations

from mjlab.tasks.registry import register_mjlab_task

from renet.tasks.config import flat_env_cfg, parkour_env_cfg
from renet.tasks.env import RenetEnv, RenetEnvCfg, env_cfg, make_env
from renet.training.config import RenetRunnerCfg
from renet.training.runner import RenetRunner

__all__ = ["RenetEnv", "RenetEnvCfg", "env_cfg", "make_env"]

for _task, _cfg in (("Renet-Go1-Flat", flat_env_cfg), ("Renet-Go1-Parkour", parkour_env_cfg)):
    register_mjlab_task(
        task_id=_task,
        env_cfg=_cfg(),
        play_env_cfg=_cfg(play=True),
        rl_cfg=RenetRunnerCfg(),
        runner_cls=RenetRunner,
    )
