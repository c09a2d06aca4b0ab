"""Environment configurations of the paper's tasks, which training/recipe.py adapts."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
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

from renet.interface import CONTROL_DT, FALL_TILT, JOINTS, PHYSICS_DT, PROPRIOCEPTION, TRUNK
from renet.robots import Robot
from renet.robots.model import CCD_ITERATIONS, FEET, ITERATIONS, LS_ITERATIONS
from renet.tasks import mdp
from renet.tasks.entity import VISUAL_GO1, entity_cfg
from renet.tasks.env import RenetEnvCfg
from renet.tasks.mdp.commands import COMMAND, GoalCommandCfg
from renet.tasks.sensors import FAR_MAP, FEET_HEIGHT, HEIGHT_MAP, depth_camera, sensors
from renet.tasks.terrains import parkour_terrain

NOISE = {
    "base_angular_velocity": 0.2,
    "projected_gravity": 0.05,
    "joint_position": 0.01,
    "joint_velocity": 1.5,
}
"""Half-widths of uniform sensor noise, in each term's unit before scaling (mjlab's Go1 task)."""


def randomize(
    cfg: RenetEnvCfg,
    *,
    motor_strength: float = 0.0,
    damping: tuple[float, float] | None = None,
    armature: tuple[float, float] | None = None,
    joint_friction: float = 0.0,
    no_load_speed: tuple[float, float] | None = None,
    joint_offset: float = 0.0,
    action_delay: float = 0.0,
    camera_delay: float = 0.0,
    camera_position: float = 0.0,
    camera_angle: float = 0.0,
) -> None:
    """Add randomisation to a task's configuration, in place. Zero or None changes nothing.

    Robots draw parameters of their bodies once, and the camera's errors and the delay of actions
    for each episode (delays that change in each step would blur targets rather than delay them).

    Args:
        cfg: The task.
        motor_strength: Largest relative change of each motor's torque limit.
        damping: Smallest and largest multiple of the nominal Kd, whose logarithm is uniform. All
            motors of a robot share it, and it replaces the task's own.
        armature: Smallest and largest multiple of the rotors' inertia, shared by a robot's motors.
        joint_friction: Largest dry friction of each joint beyond the MJCF's, N m.
        no_load_speed: Smallest and largest multiple of the motors' velocity limits at which they
            have no torque, shared by a robot's motors (see `MotorsCfg`).
        joint_offset: Largest error of the joints' zeros in observations and targets, rad.
        action_delay: Longest delay of joint targets, s, in whole physics steps.
        camera_delay: Largest age of a delivered image, s, in whole control steps.
        camera_position: Largest error of the camera's position along each axis, m.
        camera_angle: Largest error of the camera's pitch and yaw, rad.
    """
    _randomize_motors(cfg, motor_strength, damping, armature, joint_friction)
    if no_load_speed:
        cfg.motors.no_load_speed = no_load_speed
    if joint_offset:
        bias = (-joint_offset, joint_offset)
        cfg.events["joint_offset"] = _at_startup(mdp.dr.encoder_bias, bias_range=bias)
    if action_delay:
        cfg.motors.target_delay = (0.0, action_delay)
    camera = depth_camera(cfg)
    if camera_delay:
        camera.delay = (0.0, camera_delay)
    camera.mount = replace(
        camera.mount,
        position_error=camera_position or camera.mount.position_error,
        angle_error=camera_angle or camera.mount.angle_error,
    )


def _randomize_motors(
    cfg: RenetEnvCfg,
    strength: float,
    damping: tuple[float, float] | None,
    armature: tuple[float, float] | None,
    friction: float,
) -> None:
    """Add randomisation of the motors' physical parameters (see `randomize`)."""
    motors = SceneEntityCfg("robot", actuator_names=[".*"])
    joints = SceneEntityCfg("robot", joint_names=(".*",))
    if strength:
        cfg.events["motor_strength"] = _at_startup(
            mdp.dr.effort_limits,
            asset_cfg=motors,
            effort_limit_range=(1.0 - strength, 1.0 + strength),
        )
    if damping:
        cfg.events["damping"] = _at_startup(mdp.servo_damping, multiples=damping)
    if armature:
        cfg.events["armature"] = _at_startup(
            mdp.dr.joint_armature,
            asset_cfg=joints,
            operation="scale",
            ranges=armature,
            shared_random=True,
        )
    if friction:
        cfg.events["joint_friction"] = _at_startup(
            mdp.dr.joint_friction, asset_cfg=joints, operation="add", ranges=(0.0, friction)
        )


def flat_env_cfg(play: bool = False, robot: Robot = VISUAL_GO1) -> RenetEnvCfg:
    """Configure the task on a plane, with goals in all directions.

    Args:
        play: Return the variant for evaluation (see `renet.tasks.env_cfg`).
        robot: The robot.
    """
    cfg = _base_env_cfg(TerrainEntityCfg(terrain_type="plane"), robot)
    command = cfg.commands[COMMAND]
    assert isinstance(command, GoalCommandCfg)
    command.resampling_time_range = (4.0, 10.0)
    command.later_turn = math.pi
    return _play(cfg) if play else cfg


def parkour_env_cfg(play: bool = False, robot: Robot = VISUAL_GO1) -> RenetEnvCfg:
    """Configure the task on the paper's terrains, with a curriculum of 10 levels."""
    return tile_env_cfg(parkour_terrain(), play, robot)


def tile_env_cfg(
    terrain: TerrainEntityCfg, play: bool = False, robot: Robot = VISUAL_GO1
) -> RenetEnvCfg:
    """Configure the parkour task on any terrain of tiles, such as `terrains.tile_row`."""
    cfg = _base_env_cfg(terrain, robot)
    if terrain.terrain_generator is not None and terrain.terrain_generator.num_rows == 1:
        cfg.scene.spec_fn = _clear_of_terrain
    cfg.terminations["in_gap"] = TerminationTermCfg(func=mdp.in_gap)
    cfg.terminations["below_map"] = TerminationTermCfg(func=mdp.below_map)
    cfg.terminations["left_tile"] = TerminationTermCfg(func=mdp.left_tile, time_out=True)
    cfg.metrics["near_edge"] = MetricsTermCfg(func=mdp.near_edge)
    cfg.metrics["clipped_near_edge"] = MetricsTermCfg(func=mdp.clipped_near_edge)
    cfg.curriculum["level"] = CurriculumTermCfg(func=mdp.TerrainLevels)
    return _play(cfg) if play else cfg


def _clear_of_terrain(spec: mujoco.MjSpec) -> None:
    """Lift the robot's initial pose, which mjlab computes once before the first reset.

    In a single row of tiles it would be inside the summit of stairs.
    """
    spec.body(f"robot/{TRUNK}").pos[2] = 10.0


def _base_env_cfg(terrain: TerrainEntityCfg, robot: Robot) -> RenetEnvCfg:
    """Configure the parts that the tasks on all terrains share."""
    tilt = {"limit_angle": FALL_TILT}
    physics = MujocoCfg(
        timestep=PHYSICS_DT,
        iterations=ITERATIONS,
        ls_iterations=LS_ITERATIONS,
        ccd_iterations=CCD_ITERATIONS,
    )
    return RenetEnvCfg(
        robot=robot,
        decimation=round(CONTROL_DT / PHYSICS_DT),
        episode_length_s=20.0,
        scene=SceneCfg(
            terrain=terrain, entities={"robot": entity_cfg(robot)}, sensors=sensors(robot)
        ),
        observations=_observations(),
        actions={
            "joint_pos": mdp.OrderedJointPositionActionCfg(
                entity_name="robot", scale=robot.action_scale, use_default_offset=True
            )
        },
        commands={COMMAND: GoalCommandCfg()},
        rewards=_rewards(),
        terminations={
            "time_out": TerminationTermCfg(func=mdp.time_out, time_out=True),
            "fallen": TerminationTermCfg(func=mdp.bad_orientation, params=tilt),
            "not_finite": TerminationTermCfg(func=mdp.not_finite),
            "stalled": TerminationTermCfg(func=mdp.stalled),
        },
        curriculum={
            "environment_steps": CurriculumTermCfg(func=mdp.EnvironmentSteps),
            # Iteration 3,900 of 15,000 with 4,096 robots.
            "command_stage": CurriculumTermCfg(func=mdp.command_stage, params={"after": 4e8}),
        },
        events=_events(),
        metrics={
            **_costs(robot),
            "collisions": MetricsTermCfg(func=mdp.reward_term, params={"name": "collision"}),
            "lin_vel_reward": MetricsTermCfg(
                func=mdp.reward_term, params={"name": "linear_velocity"}
            ),
            "reward_clipped": MetricsTermCfg(func=mdp.reward_clipped),
        },
        # MuJoCo Warp tests every pair that may touch. Sweep and prune would test more of them,
        # because terrain overlaps terrain along every axis (tests/sim/test_broadphase.py).
        sim=SimulationCfg(njmax=400, nconmax=60, mujoco=physics),
        viewer=ViewerConfig(
            origin_type=ViewerConfig.OriginType.ASSET_BODY,
            entity_name="robot",
            body_name=TRUNK,
            distance=2.0,
            elevation=-15.0,
        ),
    )


def _play(cfg: RenetEnvCfg) -> RenetEnvCfg:
    """Turn a task into its variant for evaluation, in place.

    Only the camera has noise, there are no pushes, and robots start on all levels.
    """
    cfg.observations["proprioception"].enable_corruption = False
    cfg.curriculum = {}
    if cfg.scene.terrain is not None:
        cfg.scene.terrain.max_init_terrain_level = None
    del cfg.events["push"]
    del cfg.terminations["stalled"]
    return cfg


def _observations() -> dict[str, ObservationGroupCfg]:
    """Configure the observation groups; each but `privileged` has one term."""
    # Scale and noise of each number, in the order of the proprioception.
    scales: list[float] = []
    half_widths: list[float] = []
    for term in PROPRIOCEPTION:
        scales += [term.scale] * term.size
        half_widths += [NOISE.get(term.name, 0.0)] * term.size
    scale = tuple(scales)
    noise = tuple(half_widths)

    def proprioception(noisy: bool) -> ObservationGroupCfg:
        term = ObservationTermCfg(
            func=mdp.proprioception,
            scale=scale,
            noise=UniformNoiseCfg(n_min=tuple(-half for half in noise), n_max=noise),
            params={"joints": SceneEntityCfg("robot", joint_names=JOINTS, preserve_order=True)},
        )
        return ObservationGroupCfg(terms={"value": term}, enable_corruption=noisy)

    def single(function, **params) -> ObservationGroupCfg:
        return ObservationGroupCfg({"value": ObservationTermCfg(func=function, params=params)})

    parts = {
        "trunk": SceneEntityCfg("robot", body_names=(TRUNK,)),
        "foot": SceneEntityCfg("robot", geom_names=FEET[:1]),
    }
    privileged = {
        "feet_contact": ObservationTermCfg(func=mdp.feet_contact),
        "stalled_seconds": ObservationTermCfg(func=mdp.stalled_seconds),
        "smoothed_joint_velocity": ObservationTermCfg(func=mdp.smoothed_joint_velocity),
        "physical_parameters": ObservationTermCfg(func=mdp.physical_parameters, params=parts),
    }
    return {
        "proprioception": proprioception(noisy=True),
        "proprioception_clean": proprioception(noisy=False),
        "velocity": single(mdp.velocity),
        "feet_height": single(mdp.sensor, name=FEET_HEIGHT),
        "height_map": single(mdp.sensor, name=HEIGHT_MAP),
        "far_map": single(mdp.sensor, name=FAR_MAP),
        "privileged": ObservationGroupCfg(terms=privileged),
        "depth": single(mdp.depth),
        "difficult": single(mdp.difficult),
        "easier": single(mdp.on_easier_tile),
    }


def _rewards() -> dict[str, RewardTermCfg]:
    """Configure the paper's rewards and scales, which mjlab multiplies by the step of 0.02 s."""
    return {
        "linear_velocity": RewardTermCfg(func=mdp.linear_velocity, weight=1.5),
        "yaw": RewardTermCfg(func=mdp.yaw, weight=0.5),
        "collision": RewardTermCfg(func=mdp.collision, weight=-10.0),
        "joint_energy": RewardTermCfg(func=mdp.joint_energy, weight=-1e-5),
        "action_rate": RewardTermCfg(func=mdp.action_rate, weight=-0.1),
        "default_position": RewardTermCfg(
            func=mdp.joint_deviation, weight=-0.04, params={"joint_names": (".*",)}
        ),
        "hip_position": RewardTermCfg(
            func=mdp.joint_deviation, weight=-0.5, params={"joint_names": (".*_hip_joint",)}
        ),
        "joint_acceleration": RewardTermCfg(func=mdp.joint_acceleration, weight=-2.5e-7),
        "orientation": RewardTermCfg(func=mdp.orientation, weight=-1.0),
    }


def _costs(robot: Robot) -> dict[str, MetricsTermCfg]:
    """Configure the costs of the constrained MDP, named after interface.CONSTRAINTS.

    They are metrics, which mjlab computes beside rewards and logs, because it has no manager of
    costs.
    """
    motors = {f".*_{part}_joint": motor for part, motor in robot.motors.items()}
    velocity = {"limits": {joint: 0.8 * motor.velocity for joint, motor in motors.items()}}
    torque = {"limits": {joint: 0.8 * motor.torque for joint, motor in motors.items()}}
    torque |= {"stiffness": robot.stiffness, "damping": robot.damping}
    return {
        "cost_joint_position": MetricsTermCfg(func=mdp.joint_position_cost),
        "cost_joint_velocity": MetricsTermCfg(func=mdp.joint_velocity_cost, params=velocity),
        "cost_torque": MetricsTermCfg(func=mdp.torque_cost, params=torque),
    }


def _events() -> dict[str, EventTermCfg]:
    """Configure spawning, pushes and the randomisation of the paper."""
    feet = SceneEntityCfg("robot", geom_names=FEET)
    trunk = SceneEntityCfg("robot", body_names=(TRUNK,))
    pose = {"x": (-0.3, 0.3), "y": (-0.3, 0.3), "z": (0.02, 0.04), "yaw": (-math.pi, math.pi)}
    return {
        "spawn": EventTermCfg(
            func=mdp.reset_root_state_uniform, mode="reset", params={"pose_range": pose}
        ),
        "spawn_joints": EventTermCfg(
            func=mdp.reset_joints_by_offset,
            mode="reset",
            params={"position_range": (-0.1, 0.1), "velocity_range": (0.0, 0.0)},
        ),
        "push": EventTermCfg(
            func=mdp.push_by_setting_velocity,
            mode="interval",
            interval_range_s=(6.0, 10.0),
            params={"velocity_range": {"x": (-0.5, 0.5), "y": (-0.5, 0.5)}},
        ),
        "foot_friction": _at_startup(
            mdp.dr.geom_friction,
            asset_cfg=feet,
            operation="abs",
            ranges=(0.6, 2.0),
            shared_random=True,
        ),
        "payload": _at_startup(
            mdp.dr.body_mass, asset_cfg=trunk, operation="add", ranges=(0.0, 3.0)
        ),
        "centre_of_mass": _at_startup(
            mdp.dr.body_com_offset,
            asset_cfg=trunk,
            operation="add",
            ranges={axis: (-0.05, 0.05) for axis in range(3)},
        ),
        "servo_gains": _at_startup(
            mdp.dr.pd_gains,
            asset_cfg=SceneEntityCfg("robot", actuator_names=[".*"]),
            kp_range=(0.8, 1.2),
            kd_range=(0.8, 1.2),
        ),
    }


def _at_startup(function: Callable[..., None], **params: Any) -> EventTermCfg:
    """Configure randomisation that each robot draws once."""
    return EventTermCfg(func=function, mode="startup", params=params)
