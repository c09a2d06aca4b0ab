"""Onboard controller: robot state and depth frames in, joint commands out.

`Controller.tick` is the whole 50 Hz program without threads, clocks or devices, so that the same
inputs give the same commands on a robot, in a simulator and in a replay. It never raises, whatever
its inputs are.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from renet.bundle import Bundle
from renet.deploy.cameras.base import DepthFrame
from renet.deploy.cameras.buffer import FrameBuffer
from renet.deploy.cameras.floor_view import view_problem
from renet.deploy.observation import observe
from renet.deploy.robots.base import JointCommand, RobotState, all_finite, heading
from renet.deploy.safety.checks import stand_up_problem, teleop_problem
from renet.deploy.safety.limits import SafetyCfg, limited_command, limited_velocity, rate_after
from renet.deploy.safety.machine import Mode, SafetyMachine, damping_command, stand_up_target
from renet.deploy.steering import STEERINGS
from renet.deploy.teleop.base import TeleopCommand, Velocity
from renet.deploy.watch.body import BodyWatch
from renet.deploy.watch.leg_order import LegTest
from renet.errors import RenetError
from renet.interface import ACTION_SIZE, DEPTH_SHAPE, LATENT, PROPRIOCEPTION_SIZE, Unseen
from renet.pilot import Pilot, Step
from renet.pilot.inference import InlineInference
from renet.pilot.policy import BundlePolicy
from renet.pilot.tick import Sessions
from renet.selector.selector import REMEMBERS, SEES

LATE = "the vision thread is late or dead"
"""Reason of a tick that runs blind."""
CONDUCTS = {"walk": "it walks on", "slow": "it slows down", "stop": "it stops"}
"""Conduct at the end of the ground that was seen, in words, by `interface.Unseen`."""
UNSEEN_EVENT = "unseen"
END_OF_SEEN = "the ground that it saw ends half a metre ahead"
"""Reason of that event."""
NOTHING_SEEN = "it has seen no ground yet"
"""Reason of that event where no image was ever good enough."""
A_WHILE = 0.25
"""Seconds without an image after which an event tells of it; one late frame is no news."""


@dataclass(frozen=True)
class Event:
    """A transition and its reason."""

    time: float
    """Seconds on the robot's clock."""
    what: str
    """A mode of the safety machine, `refused` (to stand up, or to go where the policy cannot), a
    state of the pilot (`sees`, `remembers` or `blind`), `unseen` (the ground ahead), `inference`,
    or the device that has a problem: `robot`, `camera`, `teleop`, `recorder`."""
    why: str


@dataclass(frozen=True)
class Decision:
    """Decision of one tick, for logs and displays."""

    command: JointCommand
    mode: Mode
    vision: bool
    """True if the VP estimator's latent drove this step."""
    has_image: bool
    """True if VP's newest tick had an image; otherwise it goes on from memory."""
    map_error: float
    """VP's own estimate of its height map's error ahead, m; zero from models that predict none."""
    probability: float
    """Vision probability P_t after this step."""
    anomaly: float
    """Reconstruction loss of the newest images, the paper's Loss_ad."""
    variance: float
    """Error of the newest images over its predicted variance; zero where none is predicted."""
    surprise: float
    """Contradiction between the newest images and what was expected; zero where none is."""
    stillness: float
    """Share of the expected change that the last images lack; zero where none is expected."""
    frame_age: float
    """Seconds since the newest good frame was taken."""
    action: np.ndarray
    """[12] policy units; zero unless walking."""
    latent: np.ndarray
    """[64] latent that drove this step."""
    asked: Velocity
    """The operator's velocity within limits; zero unless walking."""
    followed: Velocity
    """The same without what the policy cannot do, such as walking backward, and slower where
    `--unseen` slows it."""
    told: np.ndarray
    """[3] command of the policy, see `interface.TOLD`; zero unless walking."""
    velocity_op: np.ndarray
    """[3] velocity that OP estimates, m/s, base frame."""
    velocity_vp: np.ndarray
    """[3] velocity that VP estimates, m/s, base frame."""
    inferred: bool
    """True if this step took over the result of a vision tick."""
    fallback: bool
    """True if the vision tick ran blind and in this thread, because its own was late or dead."""


class Controller:
    """Drives one robot with a bundle."""

    def __init__(
        self,
        bundle: Bundle,
        safety: SafetyCfg = SafetyCfg(),  # noqa: B008  (frozen)
        inference: Callable[[Sessions], InlineInference] = InlineInference,
        mode: str = "memory",
        on_event: Callable[[Event], None] = lambda event: None,
        unseen: Unseen = "walk",
        dry_run: bool = False,
    ) -> None:
        """Set up in DAMPING.

        Args:
            bundle: Policy, robot and camera.
            safety: Limits.
            inference: Maker of the object that runs vision ticks. The default runs them in this
                thread, which is deterministic.
            mode: Mode of the pilot, see `interface.PilotMode`.
            on_event: Function that is called with every transition.
            unseen: Conduct of a robot that remembers at the end of the ground that it has seen.
            dry_run: The commands are never sent: the robot is limp.
        """
        self.robot = bundle.manifest.robot
        self._camera = bundle.manifest.camera
        self.cfg = safety
        # Before the robot moves, for it would have to wait for the models.
        _warm_up(bundle)
        self.policy = BundlePolicy(bundle, inference=inference)
        self.pilot = Pilot.of(bundle, mode=mode, policy=self.policy, unseen=unseen)
        self._conduct = unseen
        self.machine = SafetyMachine(safety)
        self._buffer = FrameBuffer()
        self._on_event = on_event
        self._watch = BodyWatch(self.robot, safety, limp=dry_run)
        self._start = np.array(self.robot.default_position)
        self._target = self._start
        self._steering = STEERINGS[bundle.manifest.told]()
        self._start_over()
        self.decision: Decision
        self._decide(damping_command(self.robot, safety), 0.0)

    def tick(
        self, state: RobotState | None, frame: DepthFrame | None, teleop: TeleopCommand, now: float
    ) -> JointCommand:
        """Do one control step; call it every 0.02 s.

        Args:
            state: Newest reading; None if there is none.
            frame: Newest depth frame, the same as before if no other came; None without a camera.
            teleop: The operator's command.
            now: Time on the robot's clock, s.

        Returns:
            A command within all limits, which only brakes if anything is wrong.
        """
        mode = self.machine.mode
        try:
            command = self._tick(state, frame, teleop, now)
        # Whatever fails, the robot must be left braked.
        except Exception as error:
            self.machine.trip(f"{type(error).__name__}: {error}", now)
            command = self._decide(damping_command(self.robot, self.cfg), now)
        if self.machine.mode is not mode:
            self.tell(now, self.machine.mode, self.machine.reason)
        return command

    def trip(self, reason: str, now: float) -> None:
        """Go to DAMPING at the caller's wish, so that the next tick only brakes."""
        if self.machine.mode is not Mode.DAMPING:
            self.machine.trip(reason, now)
            self.tell(now, Mode.DAMPING, reason)

    def close(self) -> None:
        """Stop the vision thread, if there is one."""
        self.policy.close()

    def _tick(
        self, raw: RobotState | None, frame: DepthFrame | None, teleop: TeleopCommand, now: float
    ) -> JointCommand:
        """Do one control step; raises what the pilot and the steering raise."""
        before = self.machine.mode
        warned = self._watch.warning
        self._watch.offer(raw, now)
        if self._watch.warning and not warned:
            self.tell(now, "robot", self._watch.warning)
        self._buffer.offer(frame, now)
        mode = self.machine.update(self._problem(teleop, now), teleop, now)
        if self.machine.refused:
            self.tell(now, "refused", self.machine.refused)
        state = self._watch.newest
        if mode is Mode.WALKING and state is not None:
            if before is not Mode.WALKING:
                self._start_over()
                self._steering.start(heading(state.quaternion))
                self._tell_view(now)
            return self._walk(state, teleop, now)
        if mode is Mode.STANDING_UP and state is not None:
            if before is not Mode.STANDING_UP:
                self._start = state.joint_position
                self._target = state.joint_position
                self._leg_test = LegTest(self.robot, self.cfg.leg_test_seconds, state)
            command = self._limited(self._rise(state, now), state, self.cfg.target_rate)
        else:
            command = damping_command(self.robot, self.cfg)
        return self._decide(command, now)

    def _rise(self, state: RobotState, now: float) -> np.ndarray:
        """Return the joint targets [12], rad, of a robot that tests its legs and then stands up."""
        elapsed = now - self.machine.since
        standing = elapsed - self.cfg.leg_test_seconds
        if standing < 0.0:
            return self._leg_test.target(elapsed, state)
        return stand_up_target(self._start, self.robot, standing / self.cfg.stand_up_seconds)

    def _problem(self, teleop: TeleopCommand, now: float) -> str:
        """Return the first reason to brake; empty if there is none."""
        if problem := teleop_problem(teleop):
            return problem
        problem = self._watch.problem(now)
        newest = self._watch.newest
        if not problem and self.machine.mode is Mode.STANDING_UP:
            problem = self._leg_test.problem
        if not problem and newest is not None and self.machine.stood_up(now):
            problem = stand_up_problem(newest, self.robot, self.cfg)
        return problem

    def _start_over(self) -> None:
        """Forget the last walk, and start as training starts an episode."""
        self.pilot.reset()
        self._action = np.zeros(ACTION_SIZE)
        self._asked = Velocity()
        self._told = (0.0, 0.0, 0.0)
        self._refused = False
        self._state = SEES
        self._unseen = False
        self._fallback = False

    def _walk(self, state: RobotState, teleop: TeleopCommand, now: float) -> JointCommand:
        """Let the pilot decide a step of a walk; raises RenetError if it is not finite."""
        self._told = self._steer(teleop, state, now)
        # The pilot drives a batch of robots: here it is one.
        observation = observe(state, self.robot, self._told, self._action)[None]
        step = self.pilot.step(observation, self._buffer.take(now), now)
        if step.unseen[0]:
            # The pilot may have slowed the robot in front of ground that it has not seen.
            x, y, z = self.pilot.command[0].tolist()
            self._told = (x, y, z)
            self._steering.slow(self._told)
        self._tell_fallback(step, now)
        if self.policy.op_lost[0]:
            raise RenetError("what the OP estimator found is not finite")
        action = step.action[0]
        if not all_finite(action):
            raise RenetError("the policy's action is not finite")
        self._action = action
        # Targets may move only slowly at first, so that the walk begins without a jerk.
        rate = rate_after(now - self.machine.since, self.cfg)
        command = self._limited(step.joint_target[0], state, rate)
        self._tell_state(step, now)
        self._tell_unseen(bool(step.unseen[0]), now)
        return self._decide(command, now, step)

    def _steer(
        self, teleop: TeleopCommand, state: RobotState, now: float
    ) -> tuple[float, float, float]:
        """Return the policy's command; tells once a walk if a part of the wish is refused."""
        steering = self._steering
        self._asked = limited_velocity(teleop)
        told = steering.command(self._asked, heading(state.quaternion))
        # Only once a walk: a stick that is pushed ahead always strays to the sides.
        if steering.refused and not self._refused:
            self._refused = True
            self.tell(now, "refused", steering.refused)
        return told

    def _tell_fallback(self, step: Step, now: float) -> None:
        """Tell once, until a result of vision's thread is in time, that a tick runs blind."""
        if step.fallback and not self._fallback:
            self.tell(now, "inference", f"{LATE}: this tick runs blind")
        if step.inferred:
            self._fallback = step.fallback

    def _tell_state(self, step: Step, now: float) -> None:
        """Tell that the robot now sees, remembers or is blind, if that has changed."""
        state = str(step.state[0])
        briefly = state == REMEMBERS and self.pilot.without_image[0] < A_WHILE
        if state == self._state or briefly:
            return
        reason = LATE if self.policy.fallback else str(step.reason[0])
        why = "vision is healthy" if state == SEES else self._buffer.problem or reason
        self.tell(now, state, why)
        self._state = state

    def _tell_unseen(self, unseen: bool, now: float) -> None:
        """Tell once when the robot comes to the end of the ground that it has seen."""
        if unseen and not self._unseen:
            why = END_OF_SEEN if self.pilot.reach.seen[0] else NOTHING_SEEN
            self.tell(now, UNSEEN_EVENT, f"{why}: {CONDUCTS[self._conduct]}")
        # Not again before it has seen: an operator who looks for a way turns the robot often.
        self._unseen = unseen or (self._unseen and self._state != SEES)

    def _tell_view(self, now: float) -> None:
        """Tell if a robot that stands has an image that its camera cannot have taken there."""
        image = self._buffer.image
        if image is None:
            return
        if problem := view_problem(image, self._camera, self.robot.name):
            self.tell(now, "camera", problem)

    def _limited(self, target: np.ndarray, state: RobotState, rate: float) -> JointCommand:
        """Return the command for joint targets [12], rad, that move by at most `rate`, rad/s."""
        command = limited_command(target, self._target, state, self.robot, rate)
        self._target = command.position
        return command

    def _decide(self, command: JointCommand, now: float, step: Step | None = None) -> JointCommand:
        """Keep the tick's decision, with the pilot's step if it walks; returns the command."""
        policy = self.policy
        walking = self.machine.mode is Mode.WALKING
        vision = step is not None and bool(step.vision[0])
        latent = (policy.latent_vp if vision else policy.latent_op)[0]
        self.decision = Decision(
            command=command,
            mode=self.machine.mode,
            vision=vision,
            has_image=bool(policy.has_image[0]),
            map_error=float(policy.map_error[0]),
            probability=float(self.pilot.probability[0]),
            anomaly=float(policy.anomaly_score[0]),
            variance=float(policy.variance_score[0]),
            surprise=float(policy.surprise[0]),
            stillness=float(policy.stillness[0]),
            frame_age=self._buffer.age(now),
            action=self._action if walking else np.zeros(ACTION_SIZE),
            latent=latent if walking else np.zeros(LATENT),
            asked=self._asked if walking else Velocity(),
            followed=self._steering.followed if walking else Velocity(),
            told=np.array(self._told if walking else (0.0, 0.0, 0.0)),
            velocity_op=policy.velocity_op[0],
            velocity_vp=policy.velocity_vp[0],
            inferred=step is not None and step.inferred,
            fallback=step is not None and step.fallback,
        )
        velocity = self.decision.velocity_vp if vision else self.decision.velocity_op
        self._watch.told(command, walking, velocity)
        return command

    def tell(self, now: float, what: str, why: str) -> None:
        """Tell the listener; see `Event`."""
        # A recorder whose disk is full must not brake a robot.
        with suppress(Exception):
            self._on_event(Event(now, str(what), why))


def _warm_up(bundle: Bundle) -> None:
    """Run all models once: their first run takes many times longer than the others."""
    observation = np.zeros((1, PROPRIOCEPTION_SIZE))
    image = np.zeros((1, *DEPTH_SHAPE))
    Pilot.of(bundle).step(observation, image, now=0.0)
