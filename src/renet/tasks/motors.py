"""Motors of a task's robots: their model, delays of joint targets and torque–speed curves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from mjlab.sim.sim import Simulation
from torch import Tensor

from renet.errors import RenetError
from renet.interface import PHYSICS_DT
from renet.motor_models import IDEAL
from renet.robots import Robot
from renet.sim.motors import Motors


@dataclass(kw_only=True)
class MotorsCfg:
    """Motors of a task's robots; by default MuJoCo's servos, without delays and curves."""

    model: str = IDEAL
    """ideal: MuJoCo's servos. go1: a network of a real Go1's motors, which takes neither delays nor
    torque–speed curves. Or a file of `renet identify`."""
    target_delay: tuple[float, float] = (0.0, 0.0)
    """Shortest and longest delay of joint targets, s, in whole physics steps. Each robot draws one
    delay for all its joints at the beginning of each episode."""
    joint_delay: Mapping[str, float] = field(default_factory=dict)
    """Additional delays of single joints by name, s."""
    no_load_speed: tuple[float, float] | None = None
    """Smallest and largest no-load speed, in multiples of the motors' largest velocity. Each robot
    draws one multiple for all its motors, once. The largest torque falls linearly from its limit at
    rest to zero at that speed; with None it is constant."""

    @property
    def ideal(self) -> bool:
        """True if nothing is added to the model: neither delays nor torque–speed curves."""
        return self.max_lag == 0 and self.no_load_speed is None

    @property
    def plain_servos(self) -> bool:
        """True for MuJoCo's servos to which nothing is added."""
        return self.model == IDEAL and self.ideal

    @property
    def max_lag(self) -> int:
        """Largest delay in physics steps."""
        joint_delay = max(self.joint_delay.values(), default=0.0)
        return physics_steps(self.target_delay[1]) + physics_steps(joint_delay)

    def check(self) -> None:
        """Raise RenetError for ranges that are empty or infinite."""
        low, high = self.target_delay
        if not 0.0 <= low <= high < math.inf:
            raise RenetError(f"motors.target_delay must rise from at least 0 s, got {low}, {high}")
        if self.no_load_speed is not None:
            low, high = self.no_load_speed
            if not 0.0 < low <= high < math.inf:
                raise RenetError(f"motors.no_load_speed must rise from above 0, got {low}, {high}")


def physics_steps(seconds: float) -> int:
    """Return the number of physics steps nearest to a time in s."""
    return round(seconds / PHYSICS_DT)


class RandomMotors(Motors):
    """Motors with random delays and no-load speeds."""

    def __init__(
        self, cfg: MotorsCfg, sim: Simulation, robot: Robot, num_envs: int, substeps: int
    ) -> None:
        """Draw the no-load speeds of all robots; `begin_episodes` draws the delays.

        Args:
            cfg: Ranges of delays and speeds.
            sim: Simulation with the robots.
            robot: Configuration of the robots in it.
            num_envs: Number of robots.
            substeps: Physics steps of a control step.

        Raises:
            RenetError: A range is empty or infinite.
        """
        cfg.check()
        has_curve = cfg.no_load_speed is not None
        super().__init__(sim.mj_model, num_envs, sim.device, substeps, cfg.max_lag, has_curve)
        self._cfg = cfg
        model = sim.mj_model
        names = [model.actuator(number).name.split("/")[-1] for number in range(model.nu)]
        velocity = [robot.motor(name).velocity for name in names]
        lag = [physics_steps(cfg.joint_delay.get(name, 0.0)) for name in names]
        self._velocity = torch.tensor(velocity, device=sim.device)
        """Largest velocity of each motor, [nu] rad/s."""
        self._joint_lag = torch.tensor(lag, dtype=torch.int32, device=sim.device)
        self.draw_speeds(torch.arange(num_envs, device=sim.device))

    def draw_speeds(self, ids: Tensor) -> None:
        """Draw the no-load speeds of some robots."""
        if self._cfg.no_load_speed is not None:
            low, high = self._cfg.no_load_speed
            multiple = low + (high - low) * torch.rand(len(ids), 1, device=ids.device)
            self.no_load_speed[ids] = multiple * self._velocity

    def begin_episodes(self, ids: Tensor) -> None:
        """Draw the delays of some robots, and drop their old targets."""
        shortest, longest = self._cfg.target_delay
        low = physics_steps(shortest)
        high = physics_steps(longest)
        lag = torch.randint(low, high + 1, (len(ids), 1), dtype=torch.int32, device=ids.device)
        self.lag[ids] = lag + self._joint_lag
        self.reset(ids)
