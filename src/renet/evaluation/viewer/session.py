"""One robot driven live: its policy, its selector, and camera faults that come on demand."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from renet.deploy.policy import Policy
from renet.errors import RenetError
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import ClosedLoop, StepResult
from renet.faults import Injection, Injector, Schedule
from renet.tasks.env import RenetEnv, RenetEnvCfg
from renet.tasks.mdp.commands import GoalCommandCfg, goal
from renet.tasks.sensors import HEIGHT_MAP

MODES = ("renet", "vp", "op")
"""The selector's choice, vision always, vision never."""


@dataclass(frozen=True)
class Snapshot:
    """What the robot saw and made of it at a control step."""

    depth: np.ndarray
    """[48, 64] in [0, 1], as the policy got it."""
    reconstruction: np.ndarray
    """[48, 64]"""
    anomaly: float
    """Loss_ad."""
    probability: float
    """P_t."""
    vision: bool
    """Whether the VP estimator drove the step."""
    reason: str
    """Why vision is not trusted, if the selector says."""
    fault: str
    """What is wrong with the camera; empty where nothing is."""
    predicted: np.ndarray
    """Height map of the VP estimator, [132] m."""
    true: np.ndarray
    """The terrain's, [132] m."""


class ViewerSession:
    """The environment and the policy of a viewer, both at once (mjlab's EnvProtocol).

    The viewer asks for observations, hands them to `act` and steps with the answer.
    """

    num_envs = 1

    def __init__(
        self, evaluator: Evaluator, task: str | RenetEnvCfg, speed: float, seed: int
    ) -> None:
        """Put one robot of the evaluator's bundle on a task, commanded to walk at `speed` m/s.

        Raises:
            RenetError: a task or an engine that cannot be used.
        """
        self.eval_env = evaluator.make_env(task, [0], speed, seed)
        self.policy, self._seed = Policy(evaluator.bundle), seed
        self.beta = evaluator.beta
        healthy = Injector([()], [0], seed)
        selector = evaluator.make_selector(1)
        self.loop = ClosedLoop(self.eval_env, self.policy, selector, MODES[:1], healthy)
        self.clear_fault()
        self.reset()

    # What a person does.

    def inject(self, *injections: Injection) -> None:
        """Let the camera fail; onsets count from the next step.

        Raises:
            RenetError: a fault that cannot be simulated.
        """
        now = self.loop.clock
        schedule = tuple(replace(fault, onset=now + fault.onset) for fault in injections)
        self._set(", ".join(fault.fault for fault in injections), schedule)

    def clear_fault(self) -> None:
        """End all faults of the camera."""
        self._set("", ())

    def _set(self, name: str, schedule: Schedule) -> None:
        self._fault = name
        self.loop.injector = Injector([schedule], [0], self._seed, physical=True)

    @property
    def mode(self) -> str:
        """Who chooses the estimator."""
        return str(self.loop.modes[0])

    def choose(self, mode: str) -> None:
        """Let the selector choose the estimator (renet), or always the same (vp, op)."""
        if mode not in MODES:
            raise RenetError(f"unknown mode '{mode}': choose one of {', '.join(MODES)}")
        self.loop.modes = np.array([mode])

    def steer(self, speed: float, turn: float) -> None:
        """Command `speed` m/s, and a goal yaw `turn` rad to the left of the present one."""
        command = goal(self.env)
        assert isinstance(command.cfg, GoalCommandCfg)
        command.cfg.fixed_speed = speed
        command.speed[:] = speed
        command.yaw += turn

    # What the viewer does.

    @property
    def env(self) -> RenetEnv:
        """The simulated environment."""
        return self.eval_env.env

    unwrapped = env

    @property
    def cfg(self) -> RenetEnvCfg:
        """Its configuration."""
        return self.env.cfg

    @property
    def device(self) -> str:
        """Its device."""
        return self.env.device

    def reset(self) -> None:
        """Put the robot back to its start."""
        self.loop.reset()
        self.snapshot: Snapshot | None = None

    def get_observations(self) -> StepResult:
        """What the robot senses."""
        return self.loop.result

    def act(self, result: StepResult) -> Tensor:
        """One control step of policy and selector, as on the robot; returns actions [1, 12]."""
        del result  # The loop has it.
        loop, fault = self.loop, self._fault
        action = loop.act()
        reasons = getattr(loop.selector, "reason", [""])
        self.snapshot = Snapshot(
            depth=loop.frames.image[0],
            reconstruction=self.policy.reconstruction[0, 0],
            anomaly=float(self.policy.anomaly_score[0]),
            probability=float(loop.selector.probability[0]),
            vision=not loop.use_op[0],
            reason=str(reasons[0]),
            fault=fault if loop.failing[0] else "",
            predicted=self.policy.height_map[0],
            true=self.env.scene[HEIGHT_MAP].data[0].numpy().copy(),
        )
        return torch.from_numpy(action)

    def step(self, actions: Tensor) -> tuple[()]:
        """Step the simulation; a robot that fell or left its tile starts anew."""
        self.loop.step(actions.numpy())
        return ()

    def close(self) -> None:
        """Free the simulation."""
        self.env.close()
