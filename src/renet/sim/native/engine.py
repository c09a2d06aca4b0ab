"""Native CPU engine: C MuJoCo on threads behind mjlab's Simulation interface.

Managers and sensors read and write Warp arrays, as with MuJoCo Warp, through `sim.data` and
`sim.model`. On a CPU these are plain memory: `step` and `forward` copy each environment's state and
randomised model fields into a thread's `MjModel` and `MjData`, call C MuJoCo, and copy the results
back. Poses of static geoms and sums over the whole world are not copied.

MuJoCo's step ends with poses and velocities of the state before it. A control step (`step_n`) also
computes those of the state after it. `forward_written` computes all that follows from the state, of
the few environments whose state was written since. `stages.check_mujoco` refuses unknown versions
of MuJoCo.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, get_args

import mjlab.envs.manager_based_rl_env as mjlab_env
import mujoco
import numpy as np
import torch
from mjlab.scene import Scene
from mjlab.sim.sim import Simulation

from renet.errors import RenetError, demand_name
from renet.interface import Engine
from renet.sim.motors import NO_MOTORS, Motors
from renet.sim.native import mujoco_memory, stages
from renet.sim.native.collision_culling import CollisionCulling
from renet.sim.native.compiler import Source, Struct
from renet.sim.native.copy_tables import (
    POSE,
    STATE,
    FieldCopy,
    model_copies,
    store_data,
    whole_data,
)
from renet.sim.native.stages import stages_of
from renet.sim.threads import THREADS

ENGINE_SOURCE = Source(Path(__file__).with_name("engine.cpp"))

RESET_TO_ZERO = (
    "qvel",
    "act",
    "qacc",
    "qacc_warmstart",
    "ctrl",
    "qfrc_applied",
    "xfrc_applied",
    "time",
    "sensordata",
)
"""Fields of mjData that a reset sets to zero."""

INERTIAL = {"body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_armature"}
"""Model fields of inertia. MuJoCo does not read those of a lone body, whose inertia is compiled."""


def clear_frame_flags(model: mujoco.MjModel, randomised: set[str]) -> None:
    """Clear the compiler's flags of coinciding frames that randomisation may move apart.

    Kinematics does not read the poses of flagged frames, such as those of most terrain geoms.

    Args:
        model: The model, changed in place.
        randomised: Names of the fields that differ between environments.
    """
    flags = mujoco.mjtSameFrame
    moves_inertia = bool({"body_ipos", "body_iquat"} & randomised)
    if moves_inertia:
        model.body_sameframe[:] = flags.mjSAMEFRAME_NONE
    for kind in ("geom", "site"):
        sameframe = getattr(model, f"{kind}_sameframe")
        if {f"{kind}_pos", f"{kind}_quat"} & randomised:
            sameframe[:] = flags.mjSAMEFRAME_NONE
        elif moves_inertia:
            inertial = (flags.mjSAMEFRAME_INERTIA, flags.mjSAMEFRAME_INERTIAROT)
            sameframe[np.isin(sameframe, inertial)] = flags.mjSAMEFRAME_NONE


class Worker:
    """Model and data of one thread, and the copies into and out of them."""

    def __init__(self, simulation: NativeSimulation) -> None:
        """Copy a simulation's model.

        Raises:
            RenetError: The simulation randomises a field that this engine cannot.
        """
        model = simulation.mj_model.__copy__()
        self.model = model
        if simulation.expanded_fields & INERTIAL and model.dof_simplenum.any():
            raise RenetError(
                "the native engine cannot randomise inertia in a scene with a lone free or sliding "
                "body: use the warp engine"
            )
        # An environment that diverged must keep its NaN, so that the task ends its episode.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        # A single tree is a single island.
        if model.ntree == 1:
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        # Flags for viewers, which each step would clear: 0.4 MB with the meshes of a robot.
        model.vis.global_.bvactive = 0
        clear_frame_flags(model, simulation.expanded_fields)
        self.data = mujoco.MjData(model)
        mujoco.mj_forward(model, self.data)
        wp_data = simulation.wp_data
        num_envs = simulation.num_envs
        self.pose = whole_data(wp_data, self.data, num_envs, POSE)
        self.state = whole_data(wp_data, self.data, num_envs, STATE)
        self.fields = model_copies(simulation.wp_model, model, sorted(simulation.expanded_fields))
        self.stores = store_data(wp_data, self.data, model, num_envs)

    def struct(self, wp_data: Any, culling: CollisionCulling) -> Struct:
        """Build the struct Worker of engine.cpp."""
        model = self.model
        time = FieldCopy(wp_data.time.numpy(), mujoco_memory.time(self.data))
        loads = [*self.state, time, *culling.load_masks(model), *self.fields]
        stores = [*self.stores, time]
        return ENGINE_SOURCE.struct("Worker")(
            model=model._address,
            data=self.data._address,
            nbody=mujoco_memory.model_size(model, "nbody"),
            ngeom=mujoco_memory.model_size(model, "ngeom"),
            bodies=model.nbody,
            geoms=model.ngeom,
            loads=_copies(loads),
            num_loads=len(loads),
            # Of the loads, state and time must be finite.
            num_finite=len(self.state) + 1,
            stores=_copies(stores),
            num_stores=len(stores),
            qvel=self.data.qvel,
            ctrl=self.data.ctrl,
            forcerange=model.actuator_forcerange,
        )


def _copies(copies: list[FieldCopy]) -> Any:
    """Build an array of the struct Copy of engine.cpp."""
    struct = ENGINE_SOURCE.struct("Copy")
    table = []
    for copy in copies:
        row = struct(
            warp=copy.warp,
            stride=copy.warp.strides[0],
            mujoco=copy.mujoco,
            count=copy.mujoco.size if copy.is_float else copy.mujoco.nbytes,
            convert=copy.is_float,
        )
        table.append(row)
    return (struct * len(table))(*table)


class NativeSimulation(Simulation):
    """mjlab's Simulation, stepped by C MuJoCo on a CPU.

    Contact and constraint arrays of the Warp data are not filled. Read contacts through MuJoCo's
    contact sensors, as mjlab's ContactSensor does.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Initialize the simulation; arguments are those of Simulation.

        Raises:
            RenetError: The installed version of MuJoCo is unknown.
        """
        self._workers: list[Worker] = []
        self._arguments: dict[tuple[int, bool, bool], Struct] = {}
        """Struct Advance of engine.cpp for each set of arguments of `_advance`."""
        stages.check_mujoco()
        # MuJoCo would append its warnings to a log file in the working folder.
        mujoco.set_mju_user_warning(lambda message: None)
        super().__init__(*args, **kwargs)
        self.at_rest = np.zeros(self.num_envs, bool)
        """Environments that no step advances, [N] bool; to be written in place."""
        self.culling = CollisionCulling(self.mj_model, self.mj_data, self.num_envs)
        self._motors: Motors | None = None
        self._zeroed = [getattr(self.wp_data, name).numpy() for name in RESET_TO_ZERO]

    def expand_model_fields(self, fields: tuple[str, ...]) -> None:
        """Give each environment its own values of model fields, as Simulation does."""
        super().expand_model_fields(fields)
        # Workers hold views of the old fields.
        self._workers = []

    def use_motors(self, motors: Motors) -> None:
        """Apply delays and torque–speed curves of motors from the next step on.

        With torque–speed curves, each environment must have its own `actuator_forcerange` (see
        `expand_model_fields`).
        """
        self._motors = motors
        self._workers = []

    def step(self) -> None:
        """Take a physics step in all environments."""
        with self.nan_guard.watch(self.data):
            self._advance(1, derive=False)

    def step_n(self, steps: int) -> None:
        """Take physics steps with the same controls, then compute poses of the state after them.

        Contacts, forces and accelerations are those at the beginning of the last step.
        """
        with self.nan_guard.watch(self.data):
            self._advance(steps, derive=True)

    def forward(self) -> None:
        """Compute all that follows from the present state, in all environments."""
        self._advance(0)

    def forward_written(self) -> None:
        """Do the same in environments whose state was written since `step_n` or this call."""
        self._advance(0, only_written=True)

    def reset(self, env_ids: torch.Tensor | None = None) -> None:
        """Set environments to the model's reference state, at rest and without forces."""
        ids: slice | torch.Tensor = slice(None)
        rows: slice | np.ndarray = slice(None)
        if env_ids is not None:
            ids = env_ids
            rows = env_ids.numpy()
        for field in self._zeroed:
            field[rows] = 0.0
        self.data.qpos[ids] = self._model_rows("qpos0", ids)
        if self.mj_model.nmocap:
            bodies = np.flatnonzero(self.mj_model.body_mocapid >= 0)
            order = bodies[np.argsort(self.mj_model.body_mocapid[bodies])]
            self.data.mocap_pos[ids] = self._model_rows("body_pos", ids)[..., order, :]
            self.data.mocap_quat[ids] = self._model_rows("body_quat", ids)[..., order, :]

    def _model_rows(self, name: str, ids: slice | torch.Tensor) -> torch.Tensor:
        """Return a model field of the environments `ids`, or the one that all share."""
        field = getattr(self.model, name)
        return field[ids] if field.shape[0] == self.num_envs else field[0]

    def _advance(self, steps: int, derive: bool = False, only_written: bool = False) -> None:
        """Take physics steps.

        Args:
            steps: Number of steps; 0 computes all that follows from the state.
            derive: End with poses and velocities of the state after the last step.
            only_written: Process only environments whose state was written.
        """
        if not self._workers:
            self._prepare()
        key = steps, derive, only_written
        if key not in self._arguments:
            self._arguments[key] = self._argument(*key)
        # The state of few environments is written: a second thread would begin too late.
        ENGINE_SOURCE.call("advance", self._arguments[key], alone=only_written)

    def _prepare(self) -> None:
        """Build the workers, and drop the poses of the last step."""
        self._workers = [Worker(self) for _ in range(min(THREADS, self.num_envs))]
        self._structs = [worker.struct(self.wp_data, self.culling) for worker in self._workers]
        size = sum(copy.mujoco.size for copy in self._workers[0].pose)
        self._last_pose = np.full((self.num_envs, size), np.nan, np.float32)
        self._arguments = {}

    def _argument(self, steps: int, derive: bool, only_written: bool) -> Struct:
        """Build the struct Advance of engine.cpp."""
        struct = ENGINE_SOURCE.struct("Stage")
        library = mujoco_memory.mujoco_library()
        driven = self._motors is not None
        table = []
        for stage in stages_of(self.mj_model, steps, derive, driven):
            is_drive = stage.function == stages.DRIVE
            row = struct(
                function=None if is_drive else getattr(library, stage.function),
                bodies=stage.bodies,
                geoms=stage.geoms,
            )
            table.append(row)
        motors = NO_MOTORS
        if self._motors is not None:
            motors = self._motors.fields(self.wp_model.actuator_forcerange.numpy())
        pose = self._workers[0].pose
        return ENGINE_SOURCE.struct("Advance")(
            environments=self.num_envs,
            stages=(struct * len(table))(*table),
            num_stages=len(table),
            derives=derive or not steps,
            only_written=only_written,
            at_rest=self.at_rest,
            culling=ENGINE_SOURCE.struct("Culling")(**self.culling.fields),
            motors=ENGINE_SOURCE.struct("Motors")(**motors),
            workers=(ENGINE_SOURCE.struct("Worker") * len(self._structs))(*self._structs),
            pose=_copies(pose),
            num_pose=len(pose),
            last_pose=self._last_pose,
            pose_bytes=self._last_pose.strides[0],
        )


class TerrainLast(Scene):
    """mjlab's Scene with the terrain after all that moves, so that stages can skip it."""

    def _add_terrain(self) -> None:
        """Do nothing: mjlab calls this before it adds the entities."""

    def _add_entities(self) -> None:
        super()._add_entities()
        super()._add_terrain()


@contextmanager
def use_engine(name: str, device: str) -> Iterator[None]:
    """Context in which mjlab environments are built with an engine.

    Args:
        name: `native` (C MuJoCo), `warp` (MuJoCo Warp), or `auto` (native on a CPU, otherwise
            warp).
        device: torch's name of the device, such as `cpu`.

    Raises:
        RenetError: The engine is unknown, or it is native and the device no CPU.
    """
    demand_name("engine", name, get_args(Engine))
    on_cpu = torch.device(device).type == "cpu"
    if name == "native" and not on_cpu:
        raise RenetError(f"the native engine runs on the CPU, not on {device}: use --engine warp")
    simulation = Simulation if name == "warp" or not on_cpu else NativeSimulation
    # mjlab's environment reads these classes from its module rather than from a configuration.
    original_simulation = mjlab_env.Simulation
    original_scene = mjlab_env.Scene
    mjlab_env.Simulation = simulation
    mjlab_env.Scene = TerrainLast
    try:
        yield
    finally:
        mjlab_env.Simulation = original_simulation
        mjlab_env.Scene = original_scene
