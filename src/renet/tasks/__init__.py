"""Tasks for mjlab: scenes, terms of its managers, and robots. `renet.registry` registers them."""

import mjlab  # noqa: F401  Loads renet.registry, which needs this package: see renet.sim.

from renet.tasks.entity import VISUAL_GO1
from renet.tasks.env import RenetEnv, RenetEnvCfg, env_cfg, make_env, stored_env_cfg

__all__ = ["VISUAL_GO1", "RenetEnv", "RenetEnvCfg", "env_cfg", "make_env", "stored_env_cfg"]
