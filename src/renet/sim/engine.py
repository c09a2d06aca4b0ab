"""Native CPU engine: C MuJoCo on threads behind mjlab's Simulation interface.

Managers and sensors keep reading and writing the same Warp arrays through `sim.data` and
`sim.model`. On a CPU those arrays are plain memory; `step` and `forward` copy each environment's
state and randomised model fields into a thread's `MjModel`/`MjData`, let C MuJoCo do the work, and
copy back what can have changed. Poses of static geoms never change and are not copied, nor are sums
over the whole world.

MuJoCo's step ends with poses and velocities of the state before it. A control step (`step_n`)
derives them of the state it leads to, while that is at hand, and `forward_written` all else of the
few environments that were written to since.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mjlab.envs.manager_based_rl_env as mjlab_env
import mujoco
import numpy as np
import torch
from mjlab.scene import Scene
from mjlab.sim.sim import Simulation

from renet.errors import RenetError
from renet.sim.native_call import Call
from renet.sim.native_kernel import advance
from renet.sim.neighbourhood import Neighbourhood
from renet.sim.pipeline import LIBRARY, Pipeline
from renet.sim.threads import THREADS
from renet.sim.transfer import POSE, load_rows, model_rows, store_rows

ENGINES = ("auto", "native", "warp")


@ctypes.CFUNCTYPE(None, ctypes.c_char_p)
def _ignore_warning(message: bytes) -> None:
    """MuJoCo would append each warning to a log file in the working directory."""


RESET_TO_ZERO = ("qvel", "act", "qacc", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied")
RESET_TO_ZERO += ("time", "sensordata")

INERTIAL = {"body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_armature"}
"""Model fields that MuJoCo does not look at in a body on its own: its inertia is compiled."""


def _forget_coinciding_frames(model: mujoco.MjModel, randomised: set[str]) -> None:
    """Clear the compiler's marks of frames that coincide, whose fields kinematics does not read.

    Only where randomisation may part the frames: most of a terrain's geoms keep theirs.
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
    """One thread's model and data, and the transfer programs that use them."""

    def __init__(self, simulation: NativeSimulation, known: np.ndarray) -> None:
        """Set up a thread; `known` [N, ...] keeps the POSE that all else was derived of."""
        self.model = simulation.mj_model.__copy__()
        if simulation.expanded_fields & INERTIAL and self.model.dof_simplenum.any():
            raise RenetError(
                "the native engine cannot randomise inertia in a scene with a lone free or sliding "
                "body: use the warp engine"
            )
        # A diverged environment must keep its NaN for the task to see, not restart by itself.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        # Same results; a legged robot's contacts each touch few joints, and the solver gains 16 %.
        self.model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
        if self.model.ntree == 1:  # Which makes one island, without looking for it.
            self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
        # Marks for a viewer, cleared each step: 0.4 MB with the meshes that only a viewer draws.
        self.model.vis.global_.bvactive = 0
        _forget_coinciding_frames(self.model, simulation.expanded_fields)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        watched = load_rows(simulation.wp_data, self.data, simulation.num_envs, POSE)
        loads = load_rows(simulation.wp_data, self.data, simulation.num_envs)
        guarded = len(loads)
        loads += simulation.neighbourhood.rows(self.model)
        loads += model_rows(simulation.wp_model, self.model, sorted(simulation.expanded_fields))
        stores = store_rows(simulation.wp_data, self.data, self.model, simulation.num_envs)
        rows = [number for row in (*loads, *stores) for number in row.numbers()]

        pipeline = Pipeline(self.model)

        def program(step: list[int], last_step: list[int]) -> np.ndarray:
            """Table read by native_kernel.advance."""
            head = [self.model._address, self.data._address, *pipeline.counts]
            head += [len(loads), len(stores), guarded]
            head += [known.ctypes.data, len(watched), known.strides[0]]
            for stages in (step, last_step, pipeline.derive):
                head += [len(stages) // 3, *stages]
            return np.array(head + simulation.neighbourhood.numbers() + rows, np.uint64)

        self.step = program(pipeline.step, pipeline.last_step)
        self.forward = program([], pipeline.forward)


class NativeSimulation(Simulation):
    """mjlab's Simulation stepped by C MuJoCo; CPU only.

    Contact and constraint arrays of the Warp data are not filled: read contacts through MuJoCo
    contact sensors, as mjlab's ContactSensor does.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._workers: list[Worker] = []
        self._calls: dict[tuple, Call] = {}
        super().__init__(*args, **kwargs)
        self.neighbourhood = Neighbourhood(self.mj_model, self.mj_data, self.num_envs)
        if not self.wp_device.is_cpu:
            raise RenetError(f"the native engine runs on the CPU, not on {self.device}")
        self._zeroed = [getattr(self.wp_data, name).numpy() for name in RESET_TO_ZERO]
        ctypes.c_void_p.in_dll(LIBRARY, "mju_user_warning").value = ctypes.cast(
            _ignore_warning, ctypes.c_void_p
        ).value

    def expand_model_fields(self, fields: tuple[str, ...]) -> None:
        """See Simulation.expand_model_fields; transfer programs are rebuilt at the next step."""
        super().expand_model_fields(fields)
        self._workers, self._calls = [], {}

    def step(self) -> None:
        """One physics step of every environment."""
        with self.nan_guard.watch(self.data):
            self._run("step")

    def step_n(self, steps: int) -> None:
        """Several physics steps under the same controls, and the poses they lead to.

        Contacts, forces and accelerations are those at the last step's start.
        """
        with self.nan_guard.watch(self.data):
            self._run("step", steps, derive=True)

    def forward(self) -> None:
        """Recompute everything derived from the current state of every environment."""
        self._run("forward", derive=True)

    def forward_written(self) -> None:
        """The same, but only of environments whose state is not as `step_n` or this left it."""
        self._run("forward", derive=True, only_written=True)

    def reset(self, env_ids: torch.Tensor | None = None) -> None:
        """Put environments at the model's reference state, at rest and unforced."""
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
        """A model field of the environments in `ids`, or the one they share."""
        field = getattr(self.model, name)
        return field[ids] if field.shape[0] == self.num_envs else field[0]

    def _run(
        self, program: str, steps: int = 1, derive: bool = False, only_written: bool = False
    ) -> None:
        """Let all threads take one environment after another."""
        if not self._workers:
            model = self.mj_model
            size = model.nq + model.nv + 7 * model.nmocap
            self._known = np.full((self.num_envs, size), np.nan, np.float32)
            self._workers = [Worker(self, self._known) for _ in range(THREADS)]
        kind = (program, steps, only_written, derive)
        if kind not in self._calls:
            programs = [getattr(worker, program).ctypes.data for worker in self._workers]
            numbers = (self.num_envs, steps, only_written, derive, *programs)
            # What was written is little: another thread would begin too late.
            self._calls[kind] = Call(advance, numbers, alone=only_written)
        self._calls[kind]()


class MovingFirst(Scene):
    """mjlab's Scene with the terrain after all that moves on it, as Pipeline likes it."""

    def _add_terrain(self) -> None:
        """Not yet."""

    def _add_entities(self) -> None:
        super()._add_entities()
        super()._add_terrain()


@contextmanager
def use_engine(name: str, device: str) -> Iterator[None]:
    """Build mjlab environments with the named engine while inside.

    Args:
        name: `native` (C MuJoCo), `warp` (MuJoCo Warp), or `auto`: native on a CPU, else warp.

    Raises:
        RenetError: unknown engine, or the native one off the CPU.
    """
    if name not in ENGINES:
        raise RenetError(f"unknown engine {name!r}: choose one of {', '.join(ENGINES)}")
    on_cpu = torch.device(device).type == "cpu"
    if name == "native" and not on_cpu:
        raise RenetError(f"the native engine runs on the CPU, not on {device}: use --engine warp")
    chosen = Simulation if name == "warp" or not on_cpu else NativeSimulation
    # mjlab's environment names these classes in the module, not in a configuration.
    originals = mjlab_env.Simulation, mjlab_env.Scene
    mjlab_env.Simulation, mjlab_env.Scene = chosen, MovingFirst
    try:
        yield
    finally:
        mjlab_env.Simulation, mjlab_env.Scene = originals
