"""RENet's simulated tasks as the environment of a rollout."""

import io
import warnings
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from copy import deepcopy
from typing import cast

import mujoco
import numpy as np
import torch
from mjlab.managers.termination_manager import TerminationTermCfg
from mjlab.terrains import TerrainEntityCfg
from scipy.spatial.transform import Rotation
from torch import Tensor

from renet.bundle.manifest import Manifest
from renet.errors import RenetError
from renet.evaluation.conditions import Disturbances
from renet.evaluation.rollout import FLAT
from renet.evaluation.trace import StepResult
from renet.faults import ViewPerturbation
from renet.faults.physical import choose_evenly, obstacles
from renet.interface import (
    FALL_TILT,
    JOINT_MARGIN,
    MAX_BASE_RATE,
    MAX_JOINT_SPEED,
    TARGET_RATE,
    Told,
)
from renet.robots import Robot
from renet.sim.depth.camera import CameraPerturbation, DepthCamera
from renet.sim.native.engine import NativeSimulation
from renet.tasks import RenetEnv, RenetEnvCfg, env_cfg, make_env, mdp
from renet.tasks.mdp.base_state import tile_terrain
from renet.tasks.mdp.commands import (
    COMMAND,
    DriveCommand,
    DriveCommandCfg,
    GoalCommandCfg,
    goal,
)
from renet.tasks.mdp.rewards import collision, joint_energy
from renet.tasks.motor_models import NetworkActuator
from renet.tasks.parkour_env_cfg import flat_env_cfg, tile_env_cfg
from renet.tasks.sensors import DEPTH_CAMERA
from renet.tasks.terrains import EVALUATION_SEED, parkour_terrain, tile_row

NEVER = 1e9
"""Seconds no run lasts."""
SENSED = ("proprioception", "depth")
"""Groups of observations that a robot has."""


def trained_env_cfg(manifest: Manifest) -> RenetEnvCfg:
    """The task a bundle was trained on; raises RenetError if it is not registered here."""
    task = manifest.provenance.task
    try:
        return env_cfg(task or "Renet-Go1-Parkour")
    except RenetError as error:
        raise RenetError(
            f"the bundle's task {task} is unknown here: start from the file that describes its"
            f" robot, {manifest.robot.name} (docs/robots.md)"
        ) from error


def robot_of(manifest: Manifest) -> Robot:
    """The robot a bundle was trained on; raises RenetError if its task is not registered here."""
    return trained_env_cfg(manifest).robot


def terrain_env_cfg(
    terrain: str | Mapping[str, int] | TerrainEntityCfg, robot: Robot
) -> RenetEnvCfg:
    """A task to measure in; its random tiles are not training's.

    Args:
        terrain: "flat", "parkour" (all tiles at all levels), or grounds side by side for
            `SimEnv.place_on`: the level, 1 to 10, of each kind of tile or "flat"; raises
            RenetError for an unknown one. Or any field of tiles.
        robot: to put there.
    """
    if terrain == FLAT:
        return flat_env_cfg(play=True, robot=robot)
    if isinstance(terrain, TerrainEntityCfg):
        tiles = terrain
    else:
        tiles = parkour_terrain(EVALUATION_SEED) if isinstance(terrain, str) else tile_row(terrain)
    return tile_env_cfg(tiles, play=True, robot=robot)


def study_env_cfg(
    task: str | RenetEnvCfg,
    speed: float,
    privileged: Sequence[str] = (),
    told: Told = "heading",
) -> RenetEnvCfg:
    """A task, or its id, for measuring: straight ahead at `speed`, m/s, ended only by a fall.

    Of what training observes, only what a robot senses is computed, and the `privileged` groups.
    Robots are told their goal as the policy was in training.
    """
    cfg = env_cfg(task, play=True) if isinstance(task, str) else task
    command = cfg.commands[COMMAND]
    assert isinstance(command, GoalCommandCfg)
    command.fixed_speed = speed
    command.told = told
    if told == "twist":
        cfg.commands[COMMAND] = DriveCommandCfg(**vars(command))
    command.resampling_time_range = (NEVER, NEVER)
    cfg.terminations.pop("time_out", None)
    cfg.observations = {name: cfg.observations[name] for name in (*SENSED, *privileged)}
    cfg.rewards, cfg.metrics = {}, {}
    obey_deployment(cfg)
    return cfg


def obey_deployment(cfg: RenetEnvCfg) -> None:
    """Hold robots of a study to what `renet deploy` lets them do, in place.

    Joint targets change no faster and stay in the joints' ranges, and a robot that would be braked
    has fallen. Torques need no limit of their own: the simulated motors saturate.
    """
    for action in cfg.actions.values():
        if isinstance(action, mdp.OrderedJointPositionActionCfg):
            action.target_rate = TARGET_RATE
    fallen = {"limit_angle": FALL_TILT}
    cfg.terminations["fallen"] = TerminationTermCfg(func=mdp.bad_orientation, params=fallen)
    limits = {
        "joint_margin": JOINT_MARGIN,
        "joint_speed": MAX_JOINT_SPEED,
        "turn_rate": MAX_BASE_RATE,
    }
    cfg.terminations["braked"] = TerminationTermCfg(func=mdp.beyond_limits, params=limits)


class SimEnv:
    """A batch of robots in RENet's environment; see `EvalEnv`.

    Rows with the same robot number are twins, in all environments of one seed and one set of robot
    numbers: bodies, camera mounts, delays, starts, noise and pushes are the same until an episode
    ends. What differs is what a study varies.
    """

    def __init__(self, cfg: RenetEnvCfg, robots: Sequence[int], seed: int, engine: str) -> None:
        """Build the environment with one row for each robot number."""
        cfg = deepcopy(cfg)
        self._disturbances = Disturbances.taken_from(cfg)
        # mjlab prints its tables and warns of choices the task makes on purpose.
        with redirect_stdout(io.StringIO()), warnings.catch_warnings(action="ignore"):
            self.env: RenetEnv = make_env(cfg, len(robots), seed=seed, engine=engine)
            self._robot = self.env.scene["robot"].data
            self._camera = cast(DepthCamera, self.env.scene[DEPTH_CAMERA])
            self._draw_bodies(robots, seed)
        self.num_robots = len(robots)
        self._seed = seed
        self._view = ViewPerturbation.none(self.num_robots)
        self._camera.normal, self._noise = self._draw_noise, torch.Generator()

    def _draw_bodies(self, robots: Sequence[int], seed: int) -> None:
        """Draw a body for each robot number, whatever the number of rows, and copy it to twins."""
        _, first, number = np.unique(np.asarray(robots), return_index=True, return_inverse=True)
        self._first, self._number = torch.from_numpy(first), torch.from_numpy(number)
        """The first row of each of R robot numbers, [R], and of each row the place among them."""
        self._twin = self._first[self._number]
        """The row each row is a twin of, [N]."""
        torch.manual_seed(seed)
        self.env.event_manager.apply("startup", self._first)
        for field in self.env.sim.expanded_fields:
            if not getattr(self.env.sim.wp_model, field).size:
                continue  # mjlab cannot read what the robot has none of, such as tendons.
            values = getattr(self.env.sim.model, field)
            values[:] = values[self._twin]
        self._robot.encoder_bias[:] = self._robot.encoder_bias[self._twin]
        if self.env.motors is not None:
            self.env.motors.draw_speeds(self._first)
            self.env.motors.copy_rows(self._twin)
        for actuator in self.env.scene["robot"].actuators:
            if isinstance(actuator, NetworkActuator):
                actuator.copy_rows(self._twin)

    @property
    def scene_spec(self) -> mujoco.MjSpec:
        """The scene, for pictures."""
        return self.env.scene.spec

    def reset(self) -> StepResult:
        """Put every robot at its start; every run of one environment begins alike."""
        self.retire(np.zeros(self.num_robots, bool))
        with redirect_stdout(io.StringIO()):
            self.env.reset(seed=self._seed)
        observation = self._start_as_twins()
        self._start = self._position().copy()
        nobody = np.zeros(self.num_robots, bool)
        return self._readings(observation, nobody, nobody)

    def _start_as_twins(self) -> dict:
        """Give every row its twin's start and observe anew, as mjlab's reset does."""
        env, twin, everybody = self.env, self._twin, torch.arange(self.num_robots)
        env.scene.reset(everybody)
        torch.manual_seed(self._seed)
        self._noise.manual_seed(self._seed)
        self._disturbances.restart(len(self._first), self._seed)
        env.event_manager.apply("reset", self._first, global_env_step_count=0)
        self._camera.reset(self._first)
        self._camera.copy_mounts(twin)
        if env.motors is not None:
            env.motors.begin_episodes(self._first)
            env.motors.copy_rows(twin)
            env.motors.reset(everybody)
        position, velocity = env.sim.data.qpos, env.sim.data.qvel
        start = position[twin]
        start[:, :3] += env.scene.env_origins - env.scene.env_origins[twin]
        position[:], velocity[:] = start, velocity[twin]
        env.sim.forward()
        env.command_manager.reset(everybody)
        env.command_manager.compute(dt=0.0, env_ids=everybody)
        env.sim.sense()
        return env.observation_manager.compute(update_history=True)

    def _draw_noise(self, depth: Tensor) -> Tensor:
        """Standard normal numbers for images [N, H, W], the same for twins."""
        drawn = torch.randn((len(self._first), *depth.shape[1:]), generator=self._noise)
        return drawn[self._number]

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step."""
        with torch.no_grad():
            self._push()
            observation, _, terminated, truncated, _ = self.env.step(torch.from_numpy(action))
        fell, ended = terminated.numpy(), (terminated | truncated).numpy()
        self._start[ended] = self._position()[ended]
        return self._readings(observation, fell, ended)

    def retire(self, mask: np.ndarray) -> None:
        """Simulate the masked robots [N] no more until the next reset, where that saves work.

        The others walk as they would beside them, to the last digit.
        """
        if isinstance(self.env.sim, NativeSimulation):
            self.env.sim.at_rest[:] = mask

    def _push(self) -> None:
        """Change the velocities of the robots that are pushed now."""
        pushed, change = self._disturbances.draw_pushes()
        rows = pushed[self._number].nonzero().flatten()
        if len(rows):
            velocity = self._robot.root_link_vel_w[rows] + change[self._number[rows]]
            self.env.scene["robot"].write_root_link_velocity_to_sim(velocity, env_ids=rows)

    def place(self, levels: np.ndarray, kinds: np.ndarray) -> None:
        """Put robots on tiles, from the next reset on.

        Args:
            levels: [N] row of the terrain, 0 the easiest. kinds: [N] its column.
        """
        terrain = tile_terrain(self.env)
        terrain.terrain_levels[:] = torch.as_tensor(levels)
        terrain.terrain_types[:] = torch.as_tensor(kinds)
        terrain.env_origins[:] = terrain.terrain_origins[levels, kinds]

    def place_on(self, grounds: Sequence[str]) -> None:
        """Put each robot on a ground of `terrain_env_cfg`, from the next reset on; [N] names."""
        kinds = list(tile_terrain(self.env).cfg.terrain_generator.sub_terrains)
        self.place(np.zeros(len(grounds), int), np.array([kinds.index(g) for g in grounds]))

    def command(self, speed: float) -> None:
        """Tell every robot a new c_x, m/s, from the next step on."""
        goal(self.env).speed[:] = speed

    def follow(self, twists: np.ndarray) -> None:
        """Let robots follow twists [N, 3] m/s, m/s, rad/s, from the next reset on.

        Raises RenetError if the policy is told a heading.
        """
        command = goal(self.env)
        if not isinstance(command, DriveCommand):
            raise RenetError(
                "the bundle's policy is told a speed and a heading: it cannot be asked to walk"
                " backward or sideways; train one with this version of renet"
            )
        command.fixed_twist = torch.as_tensor(twists, dtype=torch.float32)

    def perturb_cameras(self, view: ViewPerturbation) -> None:
        """Let the cameras see the scene so from their next image on."""
        if view == self._view:
            return
        origins = tile_terrain(self.env).terrain_origins
        middles = np.zeros((0, 2)) if origins is None else origins[..., :2].reshape(-1, 2).numpy()
        self._camera.perturbation = ray_perturbation(view, self.env.sim.mj_model, middles)
        self._view = view

    def poses(self, rows: Sequence[int]) -> np.ndarray:
        """Generalised positions [len(rows), nq], for pictures."""
        return self.env.sim.data.qpos[list(rows)].numpy().copy()

    def _position(self) -> np.ndarray:
        """Horizontal base position [N, 2]."""
        return self._robot.root_link_pos_w[:, :2].numpy()

    def _readings(self, observation: dict, fell: np.ndarray, ended: np.ndarray) -> StepResult:
        noise = self._disturbances.draw_noise()
        if noise is not None:
            noisy = observation["proprioception"] + noise[self._number]
            observation = observation | {"proprioception": noisy}
        self.observation = observation
        """The newest observations by group, also the `Evaluator.privileged`."""
        velocity = self._robot.root_link_lin_vel_w[:, :2]
        above = self._robot.root_link_pos_w[:, 2] - self.env.scene.env_origins[:, 2]
        return StepResult(
            proprioception=observation["proprioception"].numpy().astype(np.float32),
            depth=observation["depth"].numpy(),
            angular_velocity=self._robot.root_link_ang_vel_b.numpy().copy(),
            forward_velocity=(velocity * goal(self.env).direction).sum(-1).numpy(),
            height=above.numpy(),
            travelled=np.linalg.norm(self._position() - self._start, axis=1),
            collisions=collision(self.env).numpy(),
            power=joint_energy(self.env).numpy(),
            fell=fell,
            ended=ended,
        )


def ray_perturbation(
    view: ViewPerturbation, model: mujoco.MjModel, middles: np.ndarray
) -> CameraPerturbation | None:
    """Translate a camera perturbation into what the ray caster does; None if nothing changes.

    Args:
        view: of N cameras; raises RenetError if obstacles are to be glass where there are none.
        model: the scene. middles: [M, 2] horizontal middles of its tiles.
    """
    if view == ViewPerturbation.none(len(view.lift)):
        return None
    shares = np.unique(view.glass[view.glass > 0])
    tiles = obstacles(model, middles) if shares.size else []
    unseen = [
        (choose_evenly(tiles, share), torch.from_numpy(np.flatnonzero(view.glass == share)))
        for share in shares.tolist()
    ]
    lift = torch.as_tensor(view.lift, dtype=torch.float32)
    turn = torch.as_tensor(Rotation.from_rotvec(view.turn).as_matrix(), dtype=torch.float32)
    return CameraPerturbation(lift, turn, unseen)
