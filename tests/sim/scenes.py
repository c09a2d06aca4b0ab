"""Scenes of a few geoms, and stock tasks on either engine."""

from collections.abc import Callable

import mujoco
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.tasks.registry import load_env_cfg

from renet.sim.native.engine import use_engine

PLANE = '<geom type="plane" size="0 0 1"/>'
ROBOT = """<body name="robot" pos="0 0 0.5"><freejoint/>
  <site name="foot" pos="0 0 -0.2"/><geom size="0.05" mass="1"/></body>"""


def scene(*bodies: str, extra: str = "") -> mujoco.MjModel:
    """A compiled world of bodies and geoms, beside `extra` elements of the model."""
    worldbody = f"<worldbody>{''.join(bodies)}</worldbody>"
    return mujoco.MjModel.from_xml_string(f"<mujoco>{extra}{worldbody}</mujoco>")


def make(
    task: str, change: Callable[[ManagerBasedRlEnvCfg], None], engine: str
) -> ManagerBasedRlEnv:
    """mjlab's task with three robots, changed, under an engine."""
    cfg = load_env_cfg(task)
    cfg.scene.num_envs, cfg.seed = 3, 3
    change(cfg)
    with use_engine(engine, "cpu"):
        env = ManagerBasedRlEnv(cfg, "cpu")
    env.reset(seed=3)
    return env
