"""What the sender's process does, in the tests' own: who it obeys, and how it ends."""

import json
import mmap
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace

import numpy as np
import pytest

from renet.deploy.robots.base import JointCommand
from renet.deploy.robots.real import sender
from renet.deploy.robots.real.braking import BRAKE, PERIOD, Link
from renet.deploy.robots.real.mailbox import ALIVE_LAYOUT, COMMAND_LAYOUT, SIZE, VALUES, mailboxes
from renet.errors import RenetError
from renet.robots import GO1

from ... import fakes

pytestmark = pytest.mark.wall_clock


class Wire(Link):
    """A link whose robot is a list, and which can fail; its controller ends after two exchanges."""

    last: "Wire"

    def __init__(self, failure: str = "", pipe: int = -1) -> None:
        if failure == "start":
            raise RenetError("no such card")
        if failure == "library":
            raise OSError("no libddsc")
        super().__init__(GO1)
        Wire.last, self.failure, self.pipe = self, failure, pipe
        self.sent, self.times = [], []

    def _receive(self, now: float) -> None:
        self.times.append(now)
        self.state = replace(fakes.state(now), temperature=30.0, battery=0.5)
        if self.failure == "shape":
            self.state = replace(self.state, joint_position=np.zeros(11))

    def _send(self, command: JointCommand | None) -> None:
        self.sent.append(command)
        if len(self.sent) > 2000:
            pytest.fail("it never ends")
        if len(self.sent) == 2 and self.pipe >= 0:
            os.close(self.pipe)
            if self.failure == "send":
                raise OSError("the cable is out")


class Controller:
    """The controller's side of the memory, and a clock that goes on when it is looked at."""

    def __init__(self) -> None:
        self.time = 100.0
        self.descriptor = os.memfd_create("renet-test")
        os.ftruncate(self.descriptor, SIZE)
        self.boxes = mailboxes(mmap.mmap(self.descriptor, SIZE))

    def clock(self) -> float:
        self.time += 0.0001
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds

    def say(self, command: JointCommand, late: float = 0.0) -> float:
        time = self.clock() - late
        self.boxes[0].write(np.array((time,), ALIVE_LAYOUT))
        self.boxes[1].write(np.array((time, *vars(command).values()), COMMAND_LAYOUT))
        return time

    def step(self, link: Link) -> JointCommand | None:
        sender.step(link, *self.boxes[:2])
        return link.sent[-1]


@pytest.fixture
def controller(monkeypatch) -> Iterator[Controller]:
    controller = Controller()
    monkeypatch.setattr(sender, "clock", controller.clock)
    monkeypatch.setattr(sender.time, "sleep", controller.sleep)
    yield controller
    os.close(controller.descriptor)


def test_each_command_is_taken_once_and_obeyed_while_it_is_new(controller):
    link, stiff = Wire(), fakes.command(stiffness=20.0)
    assert controller.step(link) is None, "nobody has spoken"
    said = controller.say(stiff)
    for _ in range(2):
        assert (controller.step(link).stiffness == 20.0).all()
        assert link.commanded == said
    controller.say(stiff, late=1.0)
    assert not controller.step(link).stiffness.any(), "it is a second old"
    assert link.problem == ""


def test_a_bad_command_brakes_for_good_and_never_silences_the_sender(controller):
    link = Wire()
    controller.say(fakes.command())
    assert controller.step(link).stiffness.any()
    controller.say(fakes.command(np.full(12, np.nan)))
    for _ in range(3):
        assert not controller.step(link).stiffness.any()
    assert len(link.sent) == 4
    controller.say(fakes.command())
    assert (controller.step(link).damping == BRAKE).all()
    assert link.problem.startswith("the robot's driver failed: RenetError: the command's position")


@contextmanager
def processes_signals() -> Iterator[None]:
    """Handlers of this process, put back afterwards."""
    before = {number: signal.getsignal(number) for number in signal.valid_signals()}
    yield
    for number, handler in before.items():
        if signal.getsignal(number) is not handler:
            signal.signal(number, handler)


def run(controller: Controller, monkeypatch, failure: str = "") -> np.ndarray:
    """Run the process' program, with a second of braking at the end; returns its last word."""
    monkeypatch.setattr(sender, "realtime", lambda priority: nullcontext("no"))
    pipe, other_end = os.pipe()
    link, settings = f"{__name__}:{Wire.__name__}", json.dumps([failure, other_end])
    with processes_signals():
        sender.main([*map(str, (controller.descriptor, pipe, 1.0, link, settings))])
        ignored = (signal.SIGINT, signal.SIGTSTP, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE)
        assert {signal.getsignal(number) for number in ignored} == {signal.SIG_IGN}
    os.close(pipe)
    return controller.boxes[2].read()


@pytest.mark.parametrize("failure", ["", "send"])
def test_a_sender_whose_controller_is_gone_brakes_while_the_robot_sinks(
    controller, monkeypatch, failure
):
    begun = controller.say(fakes.command())
    last = run(controller, monkeypatch, failure)
    assert 1.0 < controller.time - begun < 1.1
    obeyed = [bool(command.stiffness.any()) for command in Wire.last.sent]
    assert obeyed == [True, True, *[False] * (len(obeyed) - 2)]
    np.testing.assert_allclose(np.diff(Wire.last.times), PERIOD, atol=PERIOD / 10)
    failed = "the robot's driver failed: OSError: the cable is out"
    assert last["problem"].decode() == (failed if failure else "the connection was closed")
    assert (last["valid"], last["refused"]) == (True, b"no")
    for name in VALUES:
        np.testing.assert_array_equal(last[name], getattr(Wire.last.state, name))


def test_one_that_never_commanded_leaves_the_robot_limp_at_once(controller, monkeypatch):
    run(controller, monkeypatch)
    assert Wire.last.sent == [None] * 3


def test_a_reading_of_another_shape_ends_braked(controller, monkeypatch):
    controller.say(fakes.command())
    run(controller, monkeypatch, "shape")
    assert Wire.last.problem.startswith("the robot's driver failed: ValueError")
    assert not Wire.last.sent[-1].stiffness.any()


@pytest.mark.parametrize(
    ("failure", "why"), [("start", b"no such card"), ("library", b"OSError: no libddsc")]
)
def test_a_link_that_cannot_start_is_the_senders_last_word(controller, monkeypatch, failure, why):
    last = run(controller, monkeypatch, failure)
    assert (last["valid"], last["problem"]) == (False, why)
