"""Native CPU engine: C MuJoCo on threads behind mjlab's Simulation interface.

Managers and sensors keep reading and writing the same Warp arrays through `sim.data` and
`sim.model`. On a CPU those arrays are plain memory; `step` and `forward` copy each environment's
state and randomised model fields into a thread's `MjModel`/`MjData`, let C MuJoCo do the work, and
copy back what can have changed. Poses of static geoms never change and are not copied.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import mjlab.envs.manager_based_rl_env as mjlab_env
import mujoco
import numpy as np
import torch
import warp as wp
from mjlab.sim.sim import Simulation

from renet.errors import RenetError
from renet.sim import native_kernel
from renet.sim.native_kernel import advance
from renet.sim.neighbourhood import Neighbourhood
from renet.sim.threads import THREADS, on_all_threads
from renet.sim.transfer import Transfer, load_rows, model_rows, store_rows

ENGINES = ("auto", "native", "warp")


def _library() -> ctypes.CDLL:
    """MuJoCo's own, which its Python package has loaded."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib"):
        for path in folder.glob(pattern):
            return ctypes.CDLL(str(path))
    raise RenetError(f"no MuJoCo library in {folder}: renet simulates on Linux and macOS")


LIBRARY = _library()


@ctypes.CFUNCTYPE(None, ctypes.c_char_p)
def _ignore_warning(message: bytes) -> None:
    """MuJoCo would append each warning to a log file in the working directory."""


RESET_TO_ZERO = ("qvel", "act", "qacc", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied")
RESET_TO_ZERO += ("time", "sensordata")


INERTIAL = {"body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_armature"}
"""Model fields that MuJoCo does not look at in a body on its own: its inertia is compiled."""


def _address(function: str) -> int:
    return ctypes.cast(getattr(LIBRARY, function), ctypes.c_void_p).value or 0


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

    def __init__(self, simulation: NativeSimulation) -> None:
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
        # Marks for a viewer, cleared each step: 0.4 MB with the meshes that only a viewer draws.
        self.model.vis.global_.bvactive = 0
        _forget_coinciding_frames(self.model, simulation.expanded_fields)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        loads = load_rows(simulation.wp_data, self.data, simulation.num_envs)
        guarded = len(loads)
        loads += simulation.neighbourhood.rows(self.model)
        loads += model_rows(simulation.wp_model, self.model, sorted(simulation.expanded_fields))
        stores = store_rows(simulation.wp_data, self.data, self.model, simulation.num_envs)
        self.step = self._program("mj_step", loads, stores, guarded)
        self.forward = self._program("mj_forward", loads, stores, guarded)

    def _program(
        self, function: str, loads: list[Transfer], stores: list[Transfer], guarded: int
    ) -> np.ndarray:
        """Table read by native_kernel.advance."""
        head = [self.model._address, self.data._address, _address(function)]
        head += [len(loads), len(stores), guarded]
        rows = [number for row in (*loads, *stores) for number in row.numbers()]
        return np.array(head + rows, dtype=np.uint64)


class NativeSimulation(Simulation):
    """mjlab's Simulation stepped by C MuJoCo; CPU only.

    Contact and constraint arrays of the Warp data are not filled: read contacts through MuJoCo
    contact sensors, as mjlab's ContactSensor does.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._workers: SimpleQueue[Worker] | None = None
        wp.load_module(native_kernel, device="cpu")  # Else every thread compiles it.
        super().__init__(*args, **kwargs)
        self.neighbourhood = Neighbourhood(self.mj_model, self.mj_data, self.num_envs)
        if not self.wp_device.is_cpu:
            raise RenetError(f"the native engine runs on the CPU, not on {self.device}")
        ctypes.c_void_p.in_dll(LIBRARY, "mju_user_warning").value = ctypes.cast(
            _ignore_warning, ctypes.c_void_p
        ).value

    def expand_model_fields(self, fields: tuple[str, ...]) -> None:
        """See Simulation.expand_model_fields; transfer programs are rebuilt at the next step."""
        super().expand_model_fields(fields)
        self._workers = None

    def step(self) -> None:
        """One physics step of every environment."""
        self.step_n(1)

    def step_n(self, steps: int) -> None:
        """Several physics steps under the same controls, in one call."""
        with self.nan_guard.watch(self.data):
            self._run(lambda worker: worker.step, steps)

    def forward(self) -> None:
        """Recompute everything derived from the current state of every environment."""
        self._run(lambda worker: worker.forward, 1)

    def reset(self, env_ids: torch.Tensor | None = None) -> None:
        """Put environments at the model's reference state, at rest and unforced."""
        ids = slice(None) if env_ids is None else env_ids
        for name in RESET_TO_ZERO:
            field = getattr(self.data, name)
            if field.numel():
                field[ids] = 0
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

    def _run(self, program: Callable[[Worker], np.ndarray], repeats: int) -> None:
        """Let all threads take one environment after another."""
        if self._workers is None:
            ready: SimpleQueue[Worker] = SimpleQueue()
            for _ in range(THREADS):
                ready.put(Worker(self))
            self._workers = ready  # Not before it is full: threads wait for what is missing.
        workers = self._workers
        self.neighbourhood.update(self.wp_data.qpos.numpy())

        next_env = np.zeros(1, np.int32)

        def work() -> None:
            worker = workers.get()
            try:
                inputs = [program(worker).ctypes.data, next_env.ctypes.data, self.num_envs, repeats]
                wp.launch(advance, dim=1, inputs=inputs, device="cpu")
            finally:
                workers.put(worker)

        on_all_threads(work)


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
    # mjlab's environment names its simulation class in the module, not in a configuration.
    original, mjlab_env.Simulation = mjlab_env.Simulation, chosen
    try:
        yield
    finally:
        mjlab_env.Simulation = original
