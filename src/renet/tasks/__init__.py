"""Tasks for mjlab: scenes, terms of its managers, and robots. `renet.registry` registers them."""

import mjlab  # noqa: F401  Loads renet.registry, which needs this package: see renet.sim.

from renet.tasks.env import RenetEnv, RenetEnvCfg, env_cfg, make_env
from renet.tasks.robot_cfg import Motor, RobotCfg, rename_parts

__all__ = ["Motor", "RenetEnv", "RenetEnvCfg", "RobotCfg", "env_cfg", "make_env", "rename_parts"]
