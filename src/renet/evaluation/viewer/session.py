"""One robot driven live: its policy, its selector, and camera faults that come on demand."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from renet.deploy.policy import Policy
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import ClosedLoop, StepResult
from renet.faults import Injection, Injector
from renet.tasks.env import RenetEnv, RenetEnvCfg
from renet.tasks.mdp.commands import GoalCommandCfg, goal

VIEWER_MODES = ("renet", "vp", "op")
"""The selector's choice, vision always, vision never."""


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
        self.policy, self._seed, self._fault = Policy(evaluator.bundle), seed, ""
        self.beta = evaluator.beta
        healthy = Injector([()], [0], seed)
        selector = evaluator.make_selector(1)
        modes = np.array(VIEWER_MODES[:1])
        self.loop = ClosedLoop(self.eval_env, self.policy, selector, modes, healthy)
        self.reset()

    # What a person does.

    def inject(self, *injections: Injection) -> None:
        """Let the camera fail so and no longer as before; onsets count from the next step.

        Raises:
            RenetError: a fault that cannot be simulated.
        """
        now = self.loop.clock
        schedule = tuple(replace(fault, onset=now + fault.onset) for fault in injections)
        self._fault = ", ".join(fault.fault for fault in injections)
        self.loop.injector = Injector([schedule], [0], self._seed, physical=True)

    def clear_fault(self) -> None:
        """End all faults of the camera."""
        self.inject()

    @property
    def fault(self) -> str:
        """What is wrong with the camera; empty where nothing is."""
        return self._fault if self.loop.failing[0] else ""

    def choose(self, mode: str) -> None:
        """Let the selector choose the estimator (renet), or always the same (vp, op)."""
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

    def get_observations(self) -> StepResult:
        """What the robot senses."""
        return self.loop.result

    def act(self, result: StepResult) -> Tensor:
        """One control step of policy and selector, as on the robot; returns actions [1, 12]."""
        del result  # The loop has it.
        return torch.from_numpy(self.loop.act())

    def step(self, actions: Tensor) -> tuple[()]:
        """Step the simulation; a robot that fell or left its tile starts anew."""
        self.loop.step(actions.numpy())
        return ()

    def close(self) -> None:
        """Free the simulation."""
        self.env.close()
