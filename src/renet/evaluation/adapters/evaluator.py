"""Evaluator of a policy of another project: an adapter and a model in place of a bundle."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from traceback import extract_tb

import numpy as np

from renet.bundle import SHIPPED, pretrained
from renet.errors import RenetError, demand_name, printable, unknown_name
from renet.evaluation.adapters.base import Adapter, Senses
from renet.evaluation.adapters.models import MAX_POLICY_SIZE, MisfitError, Model, open_model
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.results import Provenance
from renet.evaluation.settings import Conditions
from renet.files import read_bytes
from renet.interface import (
    ACTION_SIZE,
    DEPTH_RANGE,
    DEPTH_SHAPE,
    MAX_TURN,
    NUM_FEET,
    PROPRIOCEPTION,
    TURN_GAIN,
    proprioception_slices,
)
from renet.robots import Robot

ADAPTERS = (
    "onnx-depth",
    "extreme-parkour",
    "playground",
    "himloco",
    "robogauge",
    "robot-lab",
)
"""Adapters that come with renet, each a module of this package."""
_SLICES = proprioception_slices()
"""Place of each term in the proprioception, by its name."""
_SCALES = {term.name: term.scale for term in PROPRIOCEPTION}
"""Scale of each term of the proprioception, by its name."""


def find_adapter(name: str) -> type[Adapter]:
    """Find an adapter by name, or load it from a Python file that defines a class `Adapter`.

    Raises RenetError if there is none.
    """
    if name.endswith(".py"):
        return _adapter_of_file(Path(name))
    if name not in ADAPTERS:
        raise unknown_name("adapter", name, (*ADAPTERS, "FILE.py"))
    module = importlib.import_module(f"renet.evaluation.adapters.{name.replace('-', '_')}")
    return module.Adapter


def _adapter_of_file(path: Path) -> type[Adapter]:
    """Load the class `Adapter` of a user's own file."""
    if not path.is_file():
        raise RenetError(f"adapter {path} does not exist")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # A user's module may raise anything.
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise RenetError(
            f"adapter {path} cannot be imported: {type(error).__name__}: {printable(str(error))}"
        ) from error
    found = getattr(module, "Adapter", None)
    if not (isinstance(found, type) and issubclass(found, Adapter)) or found is Adapter:
        raise RenetError(f"{path} defines no class Adapter(renet.evaluation.adapters.base.Adapter)")
    return found


@contextmanager
def _adapter_errors(model: Model, kind: type[Adapter]) -> Iterator[None]:
    """Turn an error in an adapter's own code into a RenetError that says where and with what."""
    try:
        yield
    except MisfitError as error:
        own = not kind.__module__.startswith("renet.")
        advice = f"mend {_place(error, kind)}" if own else "choose another --adapter"
        raise RenetError(f"{error}; {advice}") from error
    except RenetError:
        raise
    # An adapter is a user's code, which may raise anything.
    except Exception as error:
        words = f"{type(error).__name__}: {printable(' '.join(str(error).split()))}"
        shapes = f", whose last run had {model.shapes}" if model.shapes else ""
        raise RenetError(
            f"{_place(error, kind)} fails with {model.name}{shapes}: {words}"
        ) from error


def _adapter_name(kind: type[Adapter]) -> str:
    """Name an adapter by the file of its `act`."""
    return f"adapter {Path(kind.act.__code__.co_filename).name}"


def _place(error: Exception, kind: type[Adapter]) -> str:
    """Name an adapter, and its line at which an error arose, if it was there."""
    for frame in reversed(extract_tb(error.__traceback__)):
        if frame.filename == kind.act.__code__.co_filename:
            return f"line {frame.lineno} of {_adapter_name(kind)}"
    return _adapter_name(kind)


def _act(adapter: Adapter, senses: Senses) -> np.ndarray:
    """Run an adapter; returns joint targets, [N, 12] rad, or raises RenetError for unfit ones."""
    kind = type(adapter)
    with _adapter_errors(adapter.model, kind):
        target = np.asarray(adapter.act(senses), np.float32)
    expected = (adapter.num_robots, ACTION_SIZE)
    if target.shape == expected and np.isfinite(target).all():
        return target
    if target.shape == expected:
        wrong = "that are not finite"
    elif target.shape == ():
        wrong = "that are no array, as where `act` returns nothing"
    else:
        wrong = f"of shape {list(target.shape)}"
    raise RenetError(
        f"{_adapter_name(kind)} with {adapter.model.name} gives joint targets {wrong}:"
        f" {list(expected)} finite ones are needed (docs/benchmark.md)"
    )


class AdaptedPolicy:
    """An adapter with the interface of `renet.pilot.policy.Policy`."""

    def __init__(self, adapter: Adapter, evaluator: AdaptedEvaluator) -> None:
        """Wrap an adapter of N robots, those of the evaluator's newest environment."""
        self._adapter = adapter
        self._evaluator = evaluator
        self._action_scale = np.float32(evaluator.robot.action_scale)
        self.anomaly_score = np.zeros(adapter.num_robots)

    def reset(self, mask: np.ndarray | None = None) -> None:
        """Clear the state of the masked robots, [N] bool; of all by default."""
        if mask is None:
            mask = np.ones(self._adapter.num_robots, bool)
        with _adapter_errors(self._adapter.model, type(self._adapter)):
            self._adapter.reset(mask)

    def step(
        self, proprioception: np.ndarray, depth: np.ndarray, op_mask: np.ndarray
    ) -> np.ndarray:
        """Act for one control step.

        Args:
            proprioception: Scaled readings, [N, 45].
            depth: Images in units of the depth range, [N, 48, 64].
            op_mask: True where OP is to act, [N] bool; unused, for an adapter has one policy.

        Returns:
            Actions in the study's units, [N, 12].
        """
        # Back to physical units.
        reading = {}
        for name, place in _SLICES.items():
            reading[name] = proprioception[:, place] / _SCALES[name]
        command = reading["command"]
        evaluator = self._evaluator
        if evaluator.bundle.manifest.told == "heading":
            command = _twist(command)
        senses = Senses(
            angular_velocity=reading["base_angular_velocity"],
            gravity=reading["projected_gravity"],
            command=command,
            joint_position=reading["joint_position"] + evaluator.default_position,
            joint_velocity=reading["joint_velocity"],
            depth=depth * DEPTH_RANGE,
            velocity=evaluator.velocity(),
            feet_contact=evaluator.feet_contact(),
        )
        target = _act(self._adapter, senses)
        # A study's action is an offset from the default position in units of the action scale.
        offset = (target - evaluator.default_position).astype(np.float32)
        return offset / self._action_scale


def _twist(heading: np.ndarray) -> np.ndarray:
    """Convert commands (c_x, sin e, cos e), [N, 3], to twists (v_x, v_y, omega_z), [N, 3]."""
    speed, sine, cosine = heading.T
    turn = np.clip(TURN_GAIN * np.arctan2(sine, cosine), -MAX_TURN, MAX_TURN)
    # A robot that is commanded to stand does not turn either.
    return np.stack((speed, np.zeros_like(speed), turn * (speed > 0.0)), axis=1)


class AdaptedEvaluator(Evaluator):
    """Evaluator of another project's model, on the robot of a bundle that comes with renet."""

    def __init__(
        self,
        path: Path,
        adapter: str,
        engine: str = "auto",
        conditions: Conditions = "training",
    ) -> None:
        """Open a model; raises RenetError if it or the adapter cannot be used.

        Args:
            path: File of the model.
            adapter: Name of an adapter, or a Python file, see `find_adapter`.
            engine: Name of the physics engine: auto, native or warp.
            conditions: Name of the conditions: training, those of that bundle's task, or nominal.
        """
        self.adapter = find_adapter(adapter)
        demand_name(f"adapter {adapter}: bundle", self.adapter.bundle, SHIPPED)
        super().__init__(pretrained(self.adapter.bundle), engine, conditions)
        self._path = path
        own = adapter.endswith(".py")
        self._source = read_bytes(Path(adapter), MAX_POLICY_SIZE, "adapter") if own else b""
        """Content of a user's own adapter; empty for one that comes with renet."""
        if self.adapter.needs_velocity:
            self.privileged = ("velocity",)
        self._check()

    @property
    def entries(self) -> dict[str, str]:
        """The rollout's mode of each entry of the benchmark that the policy can walk as."""
        if self.adapter.uses_camera:
            return {"camera": "camera", "healthy": "camera"}
        return {"blind": "blind"}

    def _check(self) -> None:
        """Act once, so that a file of the wrong shape fails before a study begins."""
        still = np.zeros((1, 3), np.float32)
        zero = np.zeros((1, ACTION_SIZE), np.float32)
        senses = Senses(
            angular_velocity=still,
            gravity=np.array([[0.0, 0.0, -1.0]], np.float32),
            command=still,
            joint_position=zero + self.default_position,
            joint_velocity=zero,
            depth=np.full((1, *DEPTH_SHAPE), DEPTH_RANGE, np.float32),
            velocity=still,
            feet_contact=np.ones((1, NUM_FEET), bool),
        )
        adapter = self._make_adapter(1)
        with _adapter_errors(adapter.model, self.adapter):
            adapter.reset(np.ones(1, bool))
        _act(adapter, senses)

    def _make_adapter(self, num_robots: int) -> Adapter:
        """Open the model for N robots; raises RenetError if it or the adapter cannot be used."""
        model = open_model(self._path)
        with _adapter_errors(model, self.adapter):
            return self.adapter(model, num_robots)

    @cached_property
    def default_position(self) -> np.ndarray:
        """Default joint positions, the zero of the proprioception's, [12] rad."""
        return np.asarray(self.bundle.manifest.robot.arrays["default_position"], np.float32)

    @property
    def robot(self) -> Robot:
        """The bundle's robot with the gains of the policy's training."""
        robot = super().robot
        return replace(robot, stiffness=self.adapter.stiffness, damping=self.adapter.damping)

    def make_policy(self, num_robots: int) -> AdaptedPolicy:
        """Make the policy for N robots of the newest environment."""
        return AdaptedPolicy(self._make_adapter(num_robots), self)

    def velocity(self) -> np.ndarray:
        """Return the true velocity in the newest environment, [N, 3] m/s; empty if unneeded."""
        if not self.adapter.needs_velocity:
            return np.zeros((0, 3))
        return self.env.observation["velocity"].numpy()

    def feet_contact(self) -> np.ndarray:
        """Return the feet on the ground in the newest environment, [N, 4] bool, if needed."""
        if not self.adapter.needs_feet_contact:
            return np.zeros((0, NUM_FEET), bool)
        return self.env.feet_contact()

    def provenance(self, seed: int) -> Provenance:
        """Return the provenance of numbers, with the name and the hash of the policy's file."""
        # The file stands in for a bundle's models and selector.
        digest = hashlib.sha256(read_bytes(self._path, MAX_POLICY_SIZE, "policy"))
        # The same file behind another adapter, or a changed one, is another policy.
        digest.update(self.adapter.__name__.encode() + self.adapter.__module__.encode())
        digest.update(self._source)
        name = self._path.stem
        return replace(super().provenance(seed), bundle=name, bundle_hash=digest.hexdigest())
