"""Environment configurations of the RENet tasks."""

from __future__ import annotations

import math

import mujoco
from mjlab.envs.mdp import dr
from mjlab.managers.curriculum_manager import CurriculumTermCfg
from mjlab.managers.event_manager import EventTermCfg
from mjlab.managers.metrics_manager import MetricsTermCfg
from mjlab.managers.observation_manager import ObservationGroupCfg, ObservationTermCfg
from mjlab.managers.reward_manager import RewardTermCfg
from mjlab.managers.scene_entity_config import SceneEntityCfg
from mjlab.managers.termination_manager import TerminationTermCfg
from mjlab.scene import SceneCfg
from mjlab.sim import MujocoCfg, SimulationCfg
from mjlab.terrains import TerrainEntityCfg
from mjlab.utils.noise import UniformNoiseCfg
from mjlab.viewer import ViewerConfig

from renet.interface import CONTROL_DT, PHYSICS_DT, PROPRIOCEPTION
from renet.tasks import curriculum, observations, rewards, terminations
from renet.tasks.actions import JointTargetCfg
from renet.tasks.commands import COMMAND, GoalCommandCfg
from renet.tasks.constraints import VIOLATED
from renet.tasks.env import RenetEnvCfg
from renet.tasks.events import Push, spawn
from renet.tasks.go1 import GO1
from renet.tasks.robot import FEET, TRUNK, Robot
from renet.tasks.sensors import FEET_HEIGHT, HEIGHT_MAP, contact_sensors, terrain_sensors
from renet.tasks.terrains import parkour_terrain

NOISE = {
    "base_angular_velocity": 0.2,
    "projected_gravity": 0.05,
    "joint_position": 0.01,
    "joint_velocity": 1.5,
}
"""Half-widths of uniform sensor noise, in each term's unit before scaling (mjlab's Go1 task)."""


def flat_env_cfg(play: bool = False, robot: Robot = GO1) -> RenetEnvCfg:
    """Renet-Go1-Flat: one plane, any yaw."""
    cfg = _base_env_cfg(TerrainEntityCfg(terrain_type="plane"), robot)
    command = cfg.commands[COMMAND]
    assert isinstance(command, GoalCommandCfg)
    command.resampling_time_range, command.later_turn = (4.0, 10.0), math.pi
    return _play(cfg) if play else cfg


def parkour_env_cfg(play: bool = False, robot: Robot = GO1) -> RenetEnvCfg:
    """Renet-Go1-Parkour: the paper's terrains under a 10-level curriculum."""
    return tile_env_cfg(parkour_terrain(), play, robot)


def tile_env_cfg(terrain: TerrainEntityCfg, play: bool = False, robot: Robot = GO1) -> RenetEnvCfg:
    """The parkour task on any terrain made of tiles (see terrains.single_tile_terrain)."""
    cfg = _base_env_cfg(terrain, robot)
    if terrain.terrain_generator is not None and terrain.terrain_generator.num_rows == 1:
        cfg.scene.spec_fn = _clear_of_terrain
    cfg.terminations["in_gap"] = TerminationTermCfg(func=terminations.in_gap)
    cfg.terminations["below_map"] = TerminationTermCfg(func=terminations.below_map)
    cfg.terminations["left_tile"] = TerminationTermCfg(func=terminations.left_tile, time_out=True)
    cfg.curriculum["level"] = CurriculumTermCfg(func=curriculum.TerrainLevels)
    return _play(cfg) if play else cfg


def _clear_of_terrain(spec: mujoco.MjSpec) -> None:
    """Lift the pose that MuJoCo starts from, which mjlab evaluates once before the first reset.

    At the origin, on a single tile, it is inside the summit of the stairs: more contacts than fit.
    """
    spec.body(f"robot/{TRUNK}").pos[2] = 10.0


def _base_env_cfg(terrain: TerrainEntityCfg, robot: Robot) -> RenetEnvCfg:
    return RenetEnvCfg(
        robot=robot,
        decimation=round(CONTROL_DT / PHYSICS_DT),
        episode_length_s=20.0,
        scene=SceneCfg(
            terrain=terrain,
            entities={"robot": robot.entity()},
            sensors=(*contact_sensors(), *terrain_sensors(robot)),
        ),
        observations=_observations(),
        actions={
            "joint_pos": JointTargetCfg(
                entity_name="robot", scale=robot.action_scale, use_default_offset=True
            )
        },
        commands={COMMAND: GoalCommandCfg()},
        rewards=_rewards(),
        terminations={
            "time_out": TerminationTermCfg(func=terminations.time_out, time_out=True),
            "fallen": TerminationTermCfg(func=terminations.fallen),
            "not_finite": TerminationTermCfg(func=terminations.not_finite),
            "stalled": TerminationTermCfg(func=terminations.stalled),
        },
        curriculum={
            "command_stage": CurriculumTermCfg(
                # 4,000 iterations of 25 steps: after the first gaits, well before the end.
                func=curriculum.command_stage,
                params={"switch_step": 100_000},
            )
        },
        events=_events(),
        metrics=_metrics(),
        sim=SimulationCfg(
            njmax=200,
            nconmax=60,
            # One set of physics options for both engines, so that policies transfer.
            mujoco=MujocoCfg(
                timestep=PHYSICS_DT, iterations=20, ls_iterations=20, ccd_iterations=50
            ),
        ),
        viewer=ViewerConfig(
            origin_type=ViewerConfig.OriginType.ASSET_BODY,
            entity_name="robot",
            body_name=TRUNK,
            distance=2.0,
            elevation=-15.0,
        ),
    )


def _play(cfg: RenetEnvCfg) -> RenetEnvCfg:
    """Evaluation variant: true sensors but for the camera, no pushes, all levels at once."""
    cfg.observations["proprioception"].enable_corruption = False
    cfg.curriculum = {}
    if cfg.scene.terrain is not None:
        cfg.scene.terrain.max_init_terrain_level = None
    del cfg.events["push"], cfg.terminations["stalled"]
    return cfg


def _observations() -> dict[str, ObservationGroupCfg]:
    scale = tuple(term.scale for term in PROPRIOCEPTION for _ in range(term.size))
    noise = tuple(NOISE.get(term.name, 0.0) for term in PROPRIOCEPTION for _ in range(term.size))

    def proprioception(noisy: bool) -> ObservationGroupCfg:
        term = ObservationTermCfg(
            func=observations.proprioception,
            scale=scale,
            noise=UniformNoiseCfg(n_min=tuple(-half for half in noise), n_max=noise),
        )
        return ObservationGroupCfg(terms={"value": term}, enable_corruption=noisy)

    def single(function, **params) -> ObservationGroupCfg:
        return ObservationGroupCfg(
            terms={"value": ObservationTermCfg(func=function, params=params)}
        )

    privileged = ObservationGroupCfg(
        terms={
            "feet_contact": ObservationTermCfg(func=observations.feet_contact),
            "stalled_seconds": ObservationTermCfg(func=observations.stalled_seconds),
            "smoothed_joint_velocity": ObservationTermCfg(
                func=observations.smoothed_joint_velocity
            ),
            "physical_parameters": ObservationTermCfg(
                func=observations.PhysicalParameters,
                params={
                    "trunk": SceneEntityCfg("robot", body_names=(TRUNK,)),
                    "foot": SceneEntityCfg("robot", geom_names=FEET[:1]),
                },
            ),
        }
    )
    return {
        "proprioception": proprioception(noisy=True),
        "proprioception_clean": proprioception(noisy=False),
        "velocity": single(observations.velocity),
        "feet_height": single(observations.sensor, name=FEET_HEIGHT),
        "height_map": single(observations.sensor, name=HEIGHT_MAP),
        "privileged": privileged,
        "depth": single(observations.depth),
        "difficult": single(observations.difficult),
    }


def _rewards() -> dict[str, RewardTermCfg]:
    """Paper's scales; mjlab multiplies each by the step's 0.02 s."""
    return {
        "linear_velocity": RewardTermCfg(func=rewards.linear_velocity, weight=1.5),
        "yaw": RewardTermCfg(func=rewards.yaw, weight=0.5),
        "collision": RewardTermCfg(func=rewards.collision, weight=-10.0),
        "joint_energy": RewardTermCfg(func=rewards.joint_energy, weight=-1e-5),
        "action_rate": RewardTermCfg(func=rewards.action_rate, weight=-0.1),
        "default_position": RewardTermCfg(func=rewards.default_position, weight=-0.04),
        "hip_position": RewardTermCfg(func=rewards.hip_position, weight=-0.5),
        "joint_acceleration": RewardTermCfg(func=rewards.joint_acceleration, weight=-2.5e-7),
        "orientation": RewardTermCfg(func=rewards.orientation, weight=-1.0),
        # Not the paper's, hence off: `renet train --reward-weights` turns them on.
        "standing_motion": RewardTermCfg(func=rewards.standing_motion, weight=0.0),
        "foot_clearance": RewardTermCfg(func=rewards.foot_clearance, weight=0.0),
        "overspeed": RewardTermCfg(func=rewards.overspeed, weight=0.0),
        "low_trunk": RewardTermCfg(func=rewards.low_trunk, weight=0.0),
    }


def _metrics() -> dict[str, MetricsTermCfg]:
    """Logged as means over an episode's steps, beside the rewards."""
    return {
        "collisions": MetricsTermCfg(func=rewards.collision),
        "lin_vel_reward": MetricsTermCfg(func=rewards.linear_velocity),
        **{f"violated_{name}": MetricsTermCfg(func=term) for name, term in VIOLATED.items()},
    }


def _events() -> dict[str, EventTermCfg]:
    feet = SceneEntityCfg("robot", geom_names=FEET)
    trunk = SceneEntityCfg("robot", body_names=(TRUNK,))
    return {
        "spawn": EventTermCfg(
            func=spawn,
            mode="reset",
            params={
                "pose_range": {
                    "x": (-0.3, 0.3),
                    "y": (-0.3, 0.3),
                    "z": (0.02, 0.04),
                    "yaw": (-math.pi, math.pi),
                },
                "joint_offset": 0.1,
            },
        ),
        "push": EventTermCfg(func=Push, mode="step", params={"speed": 0.5, "every": (6.0, 10.0)}),
        "foot_friction": EventTermCfg(
            func=dr.geom_friction,
            mode="startup",
            params={
                "asset_cfg": feet,
                "operation": "abs",
                "ranges": (0.6, 2.0),
                "shared_random": True,
            },
        ),
        "payload": EventTermCfg(
            func=dr.body_mass,
            mode="startup",
            params={"asset_cfg": trunk, "operation": "add", "ranges": (0.0, 3.0)},
        ),
        "centre_of_mass": EventTermCfg(
            func=dr.body_com_offset,
            mode="startup",
            params={
                "asset_cfg": trunk,
                "operation": "add",
                "ranges": {0: (-0.05, 0.05), 1: (-0.05, 0.05), 2: (-0.05, 0.05)},
            },
        ),
        "servo_gains": EventTermCfg(
            func=dr.pd_gains,
            mode="startup",
            params={
                "asset_cfg": SceneEntityCfg("robot", actuator_names=[".*"]),
                "kp_range": (0.8, 1.2),
                "kd_range": (0.8, 1.2),
            },
        ),
    }
