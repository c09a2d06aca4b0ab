"""Environment of a rollout: RENet's simulated tasks with twins, pushes and physical faults."""

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
from renet.evaluation.settings import FLAT_GROUND
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
from renet.robots.model import FEET
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
from renet.tasks.sensors import DEPTH_CAMERA, FEET_CONTACT
from renet.tasks.terrains import EVALUATION_SEED, parkour_terrain, tile_row

_NEVER = 1e9
"""Time longer than any run, s."""
_SENSED = ("proprioception", "depth")
"""Groups of observations that a real robot has."""


def trained_env_cfg(manifest: Manifest) -> RenetEnvCfg:
    """Return the task a bundle was trained on; raises RenetError if it is not registered here."""
    task = manifest.provenance.task
    try:
        return env_cfg(task or "Renet-Go1-Parkour")
    except RenetError as error:
        raise RenetError(
            f"the bundle's task {task} is unknown here: start from the file that describes its"
            f" robot, {manifest.robot.name} (docs/robots.md)"
        ) from error


def terrain_env_cfg(
    terrain: str | Mapping[str, int] | TerrainEntityCfg, robot: Robot
) -> RenetEnvCfg:
    """Make a task for measurements on a terrain; its random tiles differ from the training tiles.

    Args:
        terrain: "flat"; "parkour", all tiles at all levels; grounds side by side for
            `SimEnv.place_on`, as the level, 1 to 10, of each kind of tile or "flat"; or any field
            of tiles. Raises RenetError for an unknown kind or level.
        robot: The robot.
    """
    if terrain == FLAT_GROUND:
        return flat_env_cfg(play=True, robot=robot)
    if isinstance(terrain, TerrainEntityCfg):
        tiles = terrain
    elif isinstance(terrain, str):
        tiles = parkour_terrain(EVALUATION_SEED)
    else:
        tiles = tile_row(terrain)
    return tile_env_cfg(tiles, play=True, robot=robot)


def study_env_cfg(
    task: str | RenetEnvCfg,
    speed: float,
    privileged: Sequence[str] = (),
    told: Told = "heading",
) -> RenetEnvCfg:
    """Configure a task for measurements: straight ahead, without time limit, rewards and metrics.

    Args:
        task: Configuration, which is changed in place, or id of a task.
        speed: Commanded speed, m/s.
        privileged: Groups of observations to compute in addition to a real robot's.
        told: Form of the command that the policy was trained with, heading or twist.
    """
    cfg = env_cfg(task, play=True) if isinstance(task, str) else task
    command = cfg.commands[COMMAND]
    assert isinstance(command, GoalCommandCfg)
    command.fixed_speed = speed
    command.told = told
    if told == "twist":
        cfg.commands[COMMAND] = DriveCommandCfg(**vars(command))
    command.resampling_time_range = (_NEVER, _NEVER)
    cfg.terminations.pop("time_out", None)
    # Compute nothing that no study reads.
    cfg.observations = {name: cfg.observations[name] for name in (*_SENSED, *privileged)}
    cfg.rewards = {}
    cfg.metrics = {}
    obey_deployment(cfg)
    return cfg


def obey_deployment(cfg: RenetEnvCfg) -> None:
    """Apply the limits of `renet deploy` to the robots of a study, in place.

    Joint targets have its largest rate and stay in the joints' ranges, and a robot that it would
    brake counts as fallen. Torques need no limit of their own, for the simulated motors saturate.
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
    """Batch of robots in RENet's environment; see `EvalEnv`.

    Rows with the same robot number are twins, in all environments of one seed and one set of robot
    numbers: bodies, camera mounts, delays, starts, noise and pushes are the same until an episode
    ends. They differ only in what a study varies.
    """

    def __init__(self, cfg: RenetEnvCfg, robots: Sequence[int], seed: int, engine: str) -> None:
        """Build the environment with one row for each robot number."""
        cfg = deepcopy(cfg)
        self._disturbances = Disturbances.extract(cfg)
        # mjlab prints its tables, and warns of choices that the task makes on purpose.
        with redirect_stdout(io.StringIO()), warnings.catch_warnings(action="ignore"):
            self.env: RenetEnv = make_env(cfg, len(robots), seed=seed, engine=engine)
            self._robot = self.env.scene["robot"].data
            self._camera = cast(DepthCamera, self.env.scene[DEPTH_CAMERA])
            self._draw_bodies(robots, seed)
        self.num_robots = len(robots)
        self.map_height = cfg.robot.map_height
        """Height of the base above flat ground at which height maps are zero, m."""
        self._seed = seed
        self._view = ViewPerturbation.none(self.num_robots)
        self._noise = torch.Generator()
        self._camera.normal = self._draw_noise

    def _draw_bodies(self, robots: Sequence[int], seed: int) -> None:
        """Draw a body for each robot number, whatever the number of rows, and copy it to twins."""
        _, first, number = np.unique(np.asarray(robots), return_index=True, return_inverse=True)
        self._first = torch.from_numpy(first)
        """First row of each of R robot numbers, [R]."""
        self._number = torch.from_numpy(number)
        """Place of each row's robot number among the R, [N]."""
        self._twin = self._first[self._number]
        """First row of each row's twins, [N]."""
        torch.manual_seed(seed)
        self.env.event_manager.apply("startup", self._first)
        for field in self.env.sim.expanded_fields:
            if not getattr(self.env.sim.wp_model, field).size:
                continue  # mjlab cannot read an empty field, such as a tendon's.
            values = getattr(self.env.sim.model, field)
            values[:] = values[self._twin]
        # These are no fields of the simulation's model.
        self._robot.encoder_bias[:] = self._robot.encoder_bias[self._twin]
        if self.env.motors is not None:
            self.env.motors.draw_speeds(self._first)
            self.env.motors.copy_rows(self._twin)
        for actuator in self.env.scene["robot"].actuators:
            if isinstance(actuator, NetworkActuator):
                actuator.copy_rows(self._twin)

    @property
    def scene_spec(self) -> mujoco.MjSpec:
        """Specification of the scene, for pictures."""
        return self.env.scene.spec

    def reset(self) -> StepResult:
        """Put every robot at its start, the same one in every run of this environment."""
        self.retire(np.zeros(self.num_robots, bool))
        with redirect_stdout(io.StringIO()):
            self.env.reset(seed=self._seed)
        observation = self._start_as_twins()
        self._start = self._position().copy()
        nobody = np.zeros(self.num_robots, bool)
        return self._readings(observation, nobody, nobody)

    def _start_as_twins(self) -> dict:
        """Give every row its twin's start and observe anew, as mjlab's reset does."""
        env = self.env
        twin = self._twin
        everybody = torch.arange(self.num_robots)
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
        # Twins have the same pose relative to their origins.
        position = env.sim.data.qpos
        velocity = env.sim.data.qvel
        start = position[twin]
        start[:, :3] += env.scene.env_origins - env.scene.env_origins[twin]
        position[:] = start
        velocity[:] = velocity[twin]
        env.sim.forward()
        env.command_manager.reset(everybody)
        env.command_manager.compute(dt=0.0, env_ids=everybody)
        env.sim.sense()
        return env.observation_manager.compute(update_history=True)

    def _draw_noise(self, depth: Tensor) -> Tensor:
        """Draw standard normal numbers for images [N, H, W], the same for twins."""
        noise = torch.randn((len(self._first), *depth.shape[1:]), generator=self._noise)
        return noise[self._number]

    def step(self, action: np.ndarray) -> StepResult:
        """Act [N, 12] for one control step."""
        with torch.no_grad():
            self._push()
            observation, _, terminated, truncated, _ = self.env.step(torch.from_numpy(action))
        fell = terminated.numpy()
        ended = (terminated | truncated).numpy()
        # Distances count from the next start.
        self._start[ended] = self._position()[ended]
        return self._readings(observation, fell, ended)

    def feet_contact(self) -> np.ndarray:
        """Return the feet that touch the ground, [N, 4] bool, in the order of `interface.LEGS`."""
        # The sensor has them in the model's order, which is another one in a Go2.
        names = self.env.scene[FEET_CONTACT].primary_names
        order = [names.index(foot) for foot in FEET]
        return mdp.feet_contact(self.env).numpy()[:, order] > 0.0

    def retire(self, mask: np.ndarray) -> None:
        """Stop simulating the masked robots, [N] bool, until the next reset.

        The motion of the others does not change, bit for bit. Only the native engine saves work.
        """
        if isinstance(self.env.sim, NativeSimulation):
            self.env.sim.at_rest[:] = mask

    def _push(self) -> None:
        """Change the velocities of the robots that are pushed in this step."""
        pushed, change = self._disturbances.draw_pushes()
        rows = pushed[self._number].nonzero().flatten()
        if len(rows):
            velocity = self._robot.root_link_vel_w[rows] + change[self._number[rows]]
            self.env.scene["robot"].write_root_link_velocity_to_sim(velocity, env_ids=rows)

    def place(self, levels: np.ndarray, kinds: np.ndarray) -> None:
        """Put robots on tiles, from the next reset on.

        Args:
            levels: Row of the terrain of each robot, 0 the easiest, [N].
            kinds: Its column, [N].
        """
        terrain = tile_terrain(self.env)
        terrain.terrain_levels[:] = torch.as_tensor(levels)
        terrain.terrain_types[:] = torch.as_tensor(kinds)
        terrain.env_origins[:] = terrain.terrain_origins[levels, kinds]

    def place_on(self, grounds: Sequence[str]) -> None:
        """Put each robot on a ground of `terrain_env_cfg`, from the next reset on; [N] names."""
        generator = tile_terrain(self.env).cfg.terrain_generator
        # A plane is the same everywhere.
        if generator is None:
            return
        kinds = list(generator.sub_terrains)
        columns = np.array([kinds.index(ground) for ground in grounds])
        self.place(np.zeros(len(grounds), int), columns)

    def command(self, speed: float) -> None:
        """Command every robot a new speed c_x, m/s, from the next step on."""
        goal(self.env).speed[:] = speed

    def follow(self, twists: np.ndarray) -> None:
        """Command twists (v_x, v_y, omega_z), [N, 3] in m/s and rad/s, from the next reset on.

        Raises RenetError if the policy's commands are headings.
        """
        command = goal(self.env)
        if not isinstance(command, DriveCommand):
            raise RenetError(
                "the bundle's policy is told a speed and a heading: it cannot be asked to walk"
                " backward or sideways; take --bundle go1-driven or go2-driven, or train one"
            )
        command.fixed_twist = torch.as_tensor(twists, dtype=torch.float32)

    def perturb_cameras(self, view: ViewPerturbation) -> None:
        """Set how the cameras see the scene from their next image on."""
        # Most control steps change nothing.
        if view == self._view:
            return
        origins = tile_terrain(self.env).terrain_origins
        middles = np.zeros((0, 2)) if origins is None else origins[..., :2].reshape(-1, 2).numpy()
        self._camera.perturbation = ray_perturbation(view, self.env.sim.mj_model, middles)
        self._view = view

    def poses(self, rows: Sequence[int]) -> np.ndarray:
        """Return generalised positions [len(rows), nq], for pictures."""
        return self.env.sim.data.qpos[list(rows)].numpy().copy()

    def _position(self) -> np.ndarray:
        """Return the horizontal base position, [N, 2] m."""
        return self._robot.root_link_pos_w[:, :2].numpy()

    def _readings(self, observation: dict, fell: np.ndarray, ended: np.ndarray) -> StepResult:
        """Return noisy observations and true state; `fell` and `ended` are the last step's, [N]."""
        # Twins have the same noise.
        noise = self._disturbances.draw_noise()
        if noise is not None:
            noisy = observation["proprioception"] + noise[self._number]
            observation = observation | {"proprioception": noisy}
        self.observation = observation
        """Newest observations by group, including `Evaluator.privileged`."""
        velocity = self._robot.root_link_lin_vel_w[:, :2]
        return StepResult(
            proprioception=observation["proprioception"].numpy().astype(np.float32),
            depth=observation["depth"].numpy(),
            angular_velocity=self._robot.root_link_ang_vel_b.numpy().copy(),
            forward_velocity=(velocity * goal(self.env).direction).sum(-1).numpy(),
            travelled=np.linalg.norm(self._position() - self._start, axis=1),
            collisions=collision(self.env).numpy(),
            power=joint_energy(self.env).numpy(),
            fell=fell,
            ended=ended,
        )


def ray_perturbation(
    view: ViewPerturbation, model: mujoco.MjModel, middles: np.ndarray
) -> CameraPerturbation | None:
    """Convert a perturbation of cameras to the ray caster's form; None if nothing changes.

    Args:
        view: Perturbation of N cameras; raises RenetError if it makes obstacles of glass where
            there are none.
        model: Model of the scene.
        middles: Horizontal middles of its tiles, [M, 2] m.
    """
    if view == ViewPerturbation.none(len(view.lift)):
        return None
    shares = np.unique(view.glass[view.glass > 0])
    tiles = obstacles(model, middles) if shares.size else []
    # Geoms that are invisible to some cameras, for each share of glass.
    unseen = []
    for share in shares.tolist():
        cameras = torch.from_numpy(np.flatnonzero(view.glass == share))
        unseen.append((choose_evenly(tiles, share), cameras))
    lift = torch.as_tensor(view.lift, dtype=torch.float32)
    turn = torch.as_tensor(Rotation.from_rotvec(view.turn).as_matrix(), dtype=torch.float32)
    return CameraPerturbation(lift, turn, unseen)
