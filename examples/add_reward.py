"""A task with one more reward: `python examples/add_reward.py train Renet-Go1-Level-Flat`."""

from __future__ import annotations

from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.reward_manager import RewardTermCfg
from mjlab.tasks.registry import register_mjlab_task
from torch import Tensor

from renet.cli import main
from renet.tasks.config.go1 import GO1
from renet.tasks.parkour_env_cfg import flat_env_cfg
from renet.training.config import RenetRunnerCfg
from renet.training.runner import RenetRunner


def turning(env: ManagerBasedRlEnv) -> Tensor:
    """Squared roll and pitch rate of the trunk, [N] (rad/s)^2."""
    return env.scene["robot"].data.root_link_ang_vel_b[:, :2].square().sum(-1)


def make_cfg(play: bool = False):
    """The flat task with a penalty on roll and pitch rates of the trunk."""
    cfg = flat_env_cfg(play=play, robot=GO1)
    cfg.rewards["turning"] = RewardTermCfg(func=turning, weight=-0.05)
    return cfg


register_mjlab_task(
    task_id="Renet-Go1-Level-Flat",
    env_cfg=make_cfg(),
    play_env_cfg=make_cfg(play=True),
    rl_cfg=RenetRunnerCfg(num_steps_per_env=25),
    runner_cls=RenetRunner,
)

if __name__ == "__main__":
    raise SystemExit(main())
