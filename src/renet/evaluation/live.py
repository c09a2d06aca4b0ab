"""One robot driven live: its policy, its selector, and camera faults that come on demand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from renet.deploy.policy import Policy
from renet.errors import RenetError
from renet.evaluation.lab import Lab
from renet.evaluation.rollout import UPDATES_PER_STEP, Readings, seen
from renet.evaluation.world import SimWorld
from renet.faults import Frames, Injection, Injector
from renet.interface import STEPS_PER_TICK
from renet.tasks.env import RenetEnv, RenetEnvCfg
from renet.tasks.mdp.commands import GoalCommandCfg, goal
from renet.tasks.sensors import HEIGHT_MAP

MODES = ("renet", "vp", "op")
"""The selector's choice, vision always, vision never."""


@dataclass(frozen=True)
class Moment:
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


class Session:
    """The environment and the policy of a viewer, both at once (mjlab's EnvProtocol).

    The viewer asks for observations, hands them to `act` and steps with the answer.
    """

    num_envs = 1

    def __init__(self, lab: Lab, task: str | RenetEnvCfg, speed: float, seed: int) -> None:
        """Put one robot of the lab's bundle on a task, told to walk at `speed` m/s.

        Raises:
            RenetError: a task or an engine that cannot be used.
        """
        self.world: SimWorld = lab.world(task, [0], speed, seed)
        self.policy = Policy(lab.bundle)
        self.switch = lab.switch(1)
        self.beta = lab.beta
        self.mode = MODES[0]
        self._seed = seed
        self._clock = 0
        """Control steps so far; a fault goes on where the robot starts anew."""
        self.heal()
        self.reset()

    # What a person does.

    def inject(self, fault: str, severity: int) -> None:
        """Let the camera fail from the next step on; raises RenetError for an unknown fault."""
        injection = Injection.of(fault, severity, onset=self._clock)
        self._fault = fault
        self._injector = Injector([(injection,)], [0], self._seed, physical=True)

    def heal(self) -> None:
        """Make the camera whole again."""
        self._fault = ""
        self._injector = Injector([()], [0], self._seed)

    def choose(self, mode: str) -> None:
        """Let the selector choose the estimator (renet), or always the same (vp, op)."""
        if mode not in MODES:
            raise RenetError(f"unknown mode '{mode}': choose one of {', '.join(MODES)}")
        self.mode = mode

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
        return self.world.env

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
        self.readings = self.world.reset()
        self._step = 0
        self._trusted = np.ones(1, bool)
        self._frames = Frames.healthy(self.readings.depth)
        self.policy.reset()
        self.switch.reset(np.ones(1, bool))
        self.moment: Moment | None = None

    def get_observations(self) -> Readings:
        """What the robot senses."""
        return self.readings

    def act(self, readings: Readings) -> Tensor:
        """One control step of policy and selector, as on the robot; returns actions [1, 12]."""
        # Buttons are pressed on another thread.
        injector, fault, k = self._injector, self._fault, self._step
        if k % STEPS_PER_TICK == 0:
            live = Frames.healthy(readings.depth, readings.angular_velocity)
            self._frames = injector.apply(live, self._clock)
        failing = injector.at_work(self._clock)[0]
        self._clock += 1
        self.world.disturb(injector.view(self._clock))
        vision = {"renet": bool(self._trusted[0]), "vp": True, "op": False}[self.mode]
        action = self.policy.step(
            readings.proprioception, self._frames.image, np.array([not vision])
        )
        for update in range(UPDATES_PER_STEP):
            self._trusted = self.switch.update(seen(self.policy, self._frames, k, update))
        self._step += 1
        self.moment = Moment(
            depth=self._frames.image[0],
            reconstruction=self.policy.reconstruction[0, 0],
            anomaly=float(self.policy.anomaly_score[0]),
            probability=float(self.switch.probability[0]),
            vision=vision,
            reason=str(getattr(getattr(self.switch, "selector", None), "reason", [""])[0]),
            fault=fault if failing else "",
            predicted=self.policy.height_map[0],
            true=self.env.scene[HEIGHT_MAP].data[0].numpy().copy(),
        )
        return torch.from_numpy(action)

    def step(self, actions: Tensor) -> tuple[()]:
        """Step the simulation; a robot that fell or left its tile starts anew."""
        self.readings = self.world.step(actions.numpy())
        if self.readings.ended.any():
            self.policy.reset(self.readings.ended)
            self.switch.reset(self.readings.ended)
            self._trusted = np.ones(1, bool)
        return ()

    def close(self) -> None:
        """Free the simulation."""
        self.env.close()
