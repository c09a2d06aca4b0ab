"""Native CPU engine: C MuJoCo on threads behind mjlab's Simulation interface.

Managers and sensors read and write the same Warp arrays as ever, through `sim.data` and
`sim.model`. On a CPU these are plain memory: `step` and `forward` copy each environment's state and
randomised model fields into a thread's `MjModel` and `MjData`, call C MuJoCo, and copy the results
back. Poses of static geoms and sums over the whole world are not copied.

MuJoCo's step ends with poses and velocities of the state before it. A control step (`step_n`) also
computes those of the state after it, and `forward_written` all that follows from the state of the
few environments that were written to since. `stages.check_mujoco` refuses unknown versions.
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
from renet.sim.motors import IDEAL, Motors
from renet.sim.native import mujoco_memory, stages
from renet.sim.native.collision_culling import CollisionCulling
from renet.sim.native.compiler import Source, Struct
from renet.sim.native.copy_tables import POSE, STATE, FieldCopy, load_model, store_data, whole_data
from renet.sim.native.stages import stages_of
from renet.sim.threads import THREADS

SOURCE = Source(Path(__file__).with_name("engine.cpp"))

RESET_TO_ZERO = ("qvel", "act", "qacc", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied")
RESET_TO_ZERO += ("time", "sensordata")

INERTIAL = {"body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_armature"}
"""Model fields that MuJoCo does not read of a lone body, whose inertia is compiled."""


def forget_coinciding_frames(model: mujoco.MjModel, randomised: set[str]) -> None:
    """Clear the compiler's marks of coinciding frames where randomisation may part the frames.

    Kinematics does not read the fields of marked frames, such as those of most terrain geoms.

    Args:
        model: changed in place. randomised: names of the fields that differ between environments.
    """
    marks = mujoco.mjtSameFrame
    inertial = bool({"body_ipos", "body_iquat"} & randomised)
    if inertial:
        model.body_sameframe[:] = marks.mjSAMEFRAME_NONE
    for kind in ("geom", "site"):
        same = getattr(model, f"{kind}_sameframe")
        if {f"{kind}_pos", f"{kind}_quat"} & randomised:
            same[:] = marks.mjSAMEFRAME_NONE
        elif inertial:
            of_inertia = (marks.mjSAMEFRAME_INERTIA, marks.mjSAMEFRAME_INERTIAROT)
            same[np.isin(same, of_inertia)] = marks.mjSAMEFRAME_NONE


class Worker:
    """One thread's model and data, and the copies into and out of them."""

    def __init__(self, simulation: NativeSimulation) -> None:
        """Copy a simulation's model; raises RenetError if it randomises what this engine cannot."""
        self.model = model = simulation.mj_model.__copy__()
        if simulation.expanded_fields & INERTIAL and model.dof_simplenum.any():
            raise RenetError(
                "the native engine cannot randomise inertia in a scene with a lone free or sliding "
                "body: use the warp engine"
            )
        # A diverged environment must keep its NaN for the task to see.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        if model.ntree == 1:  # One tree is one island.
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        # Marks for viewers, cleared in each step: 0.4 MB with the meshes that only viewers draw.
        model.vis.global_.bvactive = 0
        forget_coinciding_frames(model, simulation.expanded_fields)
        self.data = mujoco.MjData(model)
        mujoco.mj_forward(model, self.data)
        wp_data, num_envs = simulation.wp_data, simulation.num_envs
        self.pose = whole_data(wp_data, self.data, num_envs, POSE)
        self.state = whole_data(wp_data, self.data, num_envs, STATE)
        self.fields = load_model(simulation.wp_model, model, sorted(simulation.expanded_fields))
        self.stores = store_data(wp_data, self.data, model, num_envs)

    def struct(self, wp_data: Any, culling: CollisionCulling) -> Struct:
        """The struct Worker of engine.cpp."""
        model = self.model
        time = [FieldCopy(wp_data.time.numpy(), mujoco_memory.time(self.data))]
        loads = [*self.state, *time, *culling.load_masks(model), *self.fields]
        stores = [*self.stores, *time]
        return SOURCE.struct("Worker")(
            model=model._address,
            data=self.data._address,
            nbody=mujoco_memory.model_size(model, "nbody"),
            ngeom=mujoco_memory.model_size(model, "ngeom"),
            bodies=model.nbody,
            geoms=model.ngeom,
            loads=_copies(loads),
            num_loads=len(loads),
            num_finite=len(self.state) + len(time),
            stores=_copies(stores),
            num_stores=len(stores),
            qvel=self.data.qvel,
            ctrl=self.data.ctrl,
            forcerange=model.actuator_forcerange,
        )


def _copies(listed: list[FieldCopy]) -> Any:
    """An array of the struct Copy of engine.cpp."""
    kind = SOURCE.struct("Copy")
    table = [
        kind(
            warp=copy.warp,
            stride=copy.warp.strides[0],
            mujoco=copy.mujoco,
            count=copy.mujoco.size if copy.is_float else copy.mujoco.nbytes,
            convert=copy.is_float,
        )
        for copy in listed
    ]
    return (kind * len(table))(*table)


class NativeSimulation(Simulation):
    """mjlab's Simulation stepped by C MuJoCo; CPU only.

    Contact and constraint arrays of the Warp data are not filled. Read contacts through MuJoCo's
    contact sensors, as mjlab's ContactSensor does.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Take Simulation's arguments; raises RenetError where MuJoCo is one it does not know."""
        self._workers: list[Worker] = []
        self._arguments: dict[tuple[int, bool, bool], Struct] = {}
        """The struct Advance of engine.cpp, by the arguments of `_advance`."""
        stages.check_mujoco()
        # It would append its warnings to a log file in the working folder.
        mujoco.set_mju_user_warning(lambda message: None)
        super().__init__(*args, **kwargs)
        self.at_rest = np.zeros(self.num_envs, bool)
        """[N] environments that no step advances; write into it."""
        self.culling = CollisionCulling(self.mj_model, self.mj_data, self.num_envs)
        self._motors: Motors | None = None
        self._zeroed = [getattr(self.wp_data, name).numpy() for name in RESET_TO_ZERO]

    def expand_model_fields(self, fields: tuple[str, ...]) -> None:
        """Give each environment its own values of model fields, as Simulation does."""
        super().expand_model_fields(fields)
        self._workers = []

    def use_motors(self, motors: Motors) -> None:
        """Let motors be late, or weak at speed, from the next step on.

        Where torque falls with speed, `actuator_forcerange` must be a field of each environment's
        own (`expand_model_fields`).
        """
        self._motors = motors
        self._workers = []

    def step(self) -> None:
        """One physics step of every environment."""
        with self.nan_guard.watch(self.data):
            self._advance(1, derive=False)

    def step_n(self, steps: int) -> None:
        """Several physics steps with the same controls, then the poses of the state after them.

        Contacts, forces and accelerations are those at the beginning of the last step.
        """
        with self.nan_guard.watch(self.data):
            self._advance(steps, derive=True)

    def forward(self) -> None:
        """Compute all that follows from the present state of every environment."""
        self._advance(0)

    def forward_written(self) -> None:
        """The same for the environments whose state was written since `step_n` or this call."""
        self._advance(0, only_written=True)

    def reset(self, env_ids: torch.Tensor | None = None) -> None:
        """Put environments at rest in the model's reference state, without forces."""
        ids = slice(None) if env_ids is None else env_ids
        rows = slice(None) if env_ids is None else env_ids.numpy()
        for field in self._zeroed:
            field[rows] = 0.0
        self.data.qpos[ids] = self._model_rows("qpos0", ids)
        if self.mj_model.nmocap:
            bodies = np.flatnonzero(self.mj_model.body_mocapid >= 0)
            order = bodies[np.argsort(self.mj_model.body_mocapid[bodies])]
            self.data.mocap_pos[ids] = self._model_rows("body_pos", ids)[..., order, :]
            self.data.mocap_quat[ids] = self._model_rows("body_quat", ids)[..., order, :]

    def _model_rows(self, name: str, ids: slice | torch.Tensor) -> torch.Tensor:
        """A model field of the environments `ids`, or the one they share."""
        field = getattr(self.model, name)
        return field[ids] if field.shape[0] == self.num_envs else field[0]

    def _advance(self, steps: int, derive: bool = False, only_written: bool = False) -> None:
        """Take physics steps; if `steps` is 0, compute all that follows from the state."""
        if not self._workers:
            self._prepare()
        key = steps, derive, only_written
        if key not in self._arguments:
            self._arguments[key] = self._argument(*key)
        # Few environments are written to: a second thread would begin too late.
        SOURCE.call("advance", self._arguments[key], alone=only_written)

    def _prepare(self) -> None:
        """Set up the threads, and forget the last poses."""
        self._workers = [Worker(self) for _ in range(min(THREADS, self.num_envs))]
        self._structs = [worker.struct(self.wp_data, self.culling) for worker in self._workers]
        size = sum(copy.mujoco.size for copy in self._workers[0].pose)
        self._last_pose = np.full((self.num_envs, size), np.nan, np.float32)
        self._arguments = {}

    def _argument(self, steps: int, derive: bool, only_written: bool) -> Struct:
        """The struct Advance of engine.cpp."""
        stage, library = SOURCE.struct("Stage"), mujoco_memory.library()
        driven = self._motors is not None
        table = [
            stage(
                function=None if name == stages.DRIVE else getattr(library, name),
                bodies=bodies,
                geoms=geoms,
            )
            for name, bodies, geoms in stages_of(self.mj_model, steps, derive, driven)
        ]
        motors = IDEAL
        if self._motors is not None:
            motors = self._motors.fields(self.wp_model.actuator_forcerange.numpy())
        pose = self._workers[0].pose
        return SOURCE.struct("Advance")(
            environments=self.num_envs,
            stages=(stage * len(table))(*table),
            num_stages=len(table),
            derives=derive or not steps,
            only_written=only_written,
            at_rest=self.at_rest,
            culling=SOURCE.struct("Culling")(**self.culling.fields),
            motors=SOURCE.struct("Motors")(**motors),
            workers=(SOURCE.struct("Worker") * len(self._structs))(*self._structs),
            pose=_copies(pose),
            num_pose=len(pose),
            last_pose=self._last_pose,
            pose_bytes=self._last_pose.strides[0],
        )


class TerrainLast(Scene):
    """mjlab's Scene with the terrain after all that moves, so that stages can leave it out."""

    def _add_terrain(self) -> None:
        """Wait for the entities."""

    def _add_entities(self) -> None:
        super()._add_entities()
        super()._add_terrain()


@contextmanager
def use_engine(name: str, device: str) -> Iterator[None]:
    """A context in which mjlab environments are built with an engine.

    Args:
        name: `native` (C MuJoCo; raises RenetError off the CPU), `warp` (MuJoCo Warp), or `auto`:
            native on a CPU, else warp; raises RenetError for any other.
        device: torch's name of the device, such as `cpu`.
    """
    demand_name("engine", name, get_args(Engine))
    on_cpu = torch.device(device).type == "cpu"
    if name == "native" and not on_cpu:
        raise RenetError(f"the native engine runs on the CPU, not on {device}: use --engine warp")
    simulation = Simulation if name == "warp" or not on_cpu else NativeSimulation
    # mjlab's environment takes these classes from its module, not from a configuration.
    originals = mjlab_env.Simulation, mjlab_env.Scene
    mjlab_env.Simulation, mjlab_env.Scene = simulation, TerrainLast
    try:
        yield
    finally:
        mjlab_env.Simulation, mjlab_env.Scene = originals
