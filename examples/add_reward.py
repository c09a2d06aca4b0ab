"""A task with one more reward: `python examples/add_reward.py train Renet-Go1-Level-Flat`."""

from __future__ import annotations

from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.reward_manager import RewardTermCfg
from mjlab.tasks.registry import load_env_cfg, load_rl_cfg
from torch import Tensor

from renet.cli import main
from renet.registry import register_task


def turning(env: ManagerBasedRlEnv) -> Tensor:
    """Squared roll and pitch rate of the trunk, [N] (rad/s)^2."""
    return env.scene["robot"].data.root_link_ang_vel_b[:, :2].square().sum(-1)


env, play = (load_env_cfg("Renet-Go1-Flat", play) for play in (False, True))
for cfg in (env, play):
    cfg.rewards["turning"] = RewardTermCfg(func=turning, weight=-0.05)
register_task("Renet-Go1-Level-Flat", env, play, load_rl_cfg("Renet-Go1-Flat"))

if __name__ == "__main__":
    raise SystemExit(main())
