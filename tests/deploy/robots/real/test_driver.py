"""Real drivers and their sender processes, against simulated robots that live beside them."""

import os

import pytest

from renet.errors import RenetError

from ...fakes import command, until

pytestmark = pytest.mark.wall_clock


def test_a_robot_is_read_commanded_and_braked_at_the_end(served):
    robot = served.make_driver(sink=0.3)
    with pytest.raises(RenetError, match="not connected"):
        robot.write(command())
    assert robot.read() is None
    robot.connect()
    assert robot.read() is not None
    until(lambda: served.stiff > 0, lambda: robot.write(command()))
    moment = robot.now()
    robot.wait(moment + 0.01)
    assert robot.now() >= moment + 0.01
    robot.close()
    robot.close()
    until(lambda: served.braked)
    with pytest.raises(RenetError, match="closed"):
        robot.write(command())


def test_a_connection_that_only_looked_leaves_the_robot_limp_or_braked(served):
    """A Go2's own controllers were ended: it is held until somebody commands it."""
    robot = served.make_driver(sink=0.3)
    robot.connect()
    robot.close()
    assert served.braked or not any(sent[:, 4:].any() for sent in served.commands)


def test_a_sender_that_died_is_named(served):
    robot = served.make_driver()
    robot.connect()
    robot._sender.kill()
    robot._sender.wait()
    with pytest.raises(RenetError, match=r"process that talks to the Go\d has died"):
        robot.write(command())
    robot.close()


def test_a_second_controller_is_refused_until_the_first_ones_sender_is_dead(served, monkeypatch):
    """Before a single datagram; the first's sender still brakes."""
    first, second = served.make_driver(sink=0.3), served.make_driver(sink=0.3)
    first.connect()
    with monkeypatch.context() as watched:
        watched.setattr(second, "_start", lambda lock: pytest.fail("it sent something"))
        for _ in range(2):
            with pytest.raises(RenetError, match=r"another program on this computer drives the Go"):
                second.connect()
        first._stop.set()  # As if this process were gone but for the sender.
        with pytest.raises(RenetError, match="end it first"):
            second.connect()
        os.close(first._pipe)
        first._sender.wait(10)
    second.connect()
    second.close()


def test_no_robot_is_one_clear_line(peer):
    with pytest.raises(RenetError, match=r"no answer from a Go\d .*check the cable"):
        peer.make_driver(timeout=0.5).connect()
    until(peer.released)
