"""Registers tasks with mjlab, which loads this module through the `mjlab.tasks` entry point."""

import torch
from mjlab.tasks.registry import register_mjlab_task

from renet.robots import GO2, Robot, register_robot, robots
from renet.tasks.entity import VISUAL_GO1
from renet.tasks.env import RenetEnvCfg
from renet.tasks.parkour_env_cfg import flat_env_cfg, parkour_env_cfg
from renet.training.config import RenetRunnerCfg
from renet.training.recipe import recipe
from renet.training.runner import RenetRunner

NUM_ENVS = 4096 if torch.cuda.is_available() else 512
"""The paper's number of robots on a GPU, and one that a CPU steps as fast as any."""


def register_tasks(name: str, robot: Robot) -> None:
    """Give a robot its tasks, and make it known to `renet deploy`.

    Tasks are Renet-`name`-Parkour and Renet-`name`-Flat, trained by the recipe, and
    Renet-`name`-Parkour-Paper, to which nothing of it is applied.
    """
    # The runtime may know the robot by a model of its own, as it does the Go1.
    if robot.name not in robots():
        register_robot(robot)
    for terrain, cfg in (("Flat", flat_env_cfg), ("Parkour", parkour_env_cfg)):
        env = cfg(robot=robot)
        agent = RenetRunnerCfg()
        recipe(env, agent)
        register_task(f"Renet-{name}-{terrain}", env, cfg(play=True, robot=robot), agent)
    paper = parkour_env_cfg(robot=robot)
    play = parkour_env_cfg(play=True, robot=robot)
    register_task(f"Renet-{name}-Parkour-Paper", paper, play, RenetRunnerCfg())


def register_task(
    task: str,
    env: RenetEnvCfg,
    play: RenetEnvCfg,
    agent: RenetRunnerCfg,
    runner: type[RenetRunner] = RenetRunner,
) -> None:
    """Register a task by its id: what is trained in, what is evaluated in, how, and by what."""
    env.scene.num_envs = NUM_ENVS
    agent.experiment_name = agent.task = task
    register_mjlab_task(task, env, play, agent, runner)


register_tasks("Go1", VISUAL_GO1)
register_tasks("Go2", GO2)
