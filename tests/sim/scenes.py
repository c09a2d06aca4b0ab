"""Scenes of a few geoms, MuJoCo's own rays in them, and stock tasks on either engine."""

from collections.abc import Callable

import mujoco
import numpy as np
from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab.sim.sim import MujocoCfg, SimulationCfg
from mjlab.tasks.registry import load_env_cfg

from renet.sim.native.engine import NativeSimulation, use_engine

PLANE = '<geom type="plane" size="0 0 1"/>'
ROBOT = """<body name="robot" pos="0 0 0.5"><freejoint/>
  <site name="foot" pos="0 0 -0.2"/><geom size="0.05" mass="1"/></body>"""


def scene(*bodies: str, extra: str = "") -> mujoco.MjModel:
    """A compiled world of bodies and geoms, beside `extra` elements of the model."""
    worldbody = f"<worldbody>{''.join(bodies)}</worldbody>"
    return mujoco.MjModel.from_xml_string(f"<mujoco>{extra}{worldbody}</mujoco>")


def mujoco_rays(model: mujoco.MjModel, starts, directions, without: int = -1) -> np.ndarray:
    """How far rays go, in lengths of their directions, past the body `without`; -1 for a miss."""
    data, geom = mujoco.MjData(model), np.zeros(1, np.int32)
    mujoco.mj_forward(model, data)
    rays = zip(*np.broadcast_arrays(starts, np.array(directions, float)), strict=True)
    return np.array([mujoco.mj_ray(model, data, *ray, None, 1, without, geom) for ray in rays])


def simulate(model: mujoco.MjModel, robots: int = 3, **options) -> NativeSimulation:
    """Robots of a model under the native engine, 5 ms a step."""
    cfg = SimulationCfg(mujoco=MujocoCfg(timestep=0.005, **options))
    return NativeSimulation(robots, cfg, model, "cpu")


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
