"""The browser viewer serves the simulated robot."""

import socket
from pathlib import Path
from urllib.request import urlopen

import pytest

from renet.deploy.main import LOOPBACK, DeployCfg
from renet.deploy.robots.mujoco import MujocoRobot
from renet.deploy.robots.scene import build_scene
from renet.deploy.viewer import BrowserViewer
from renet.training.bundle import robot_spec

pytest.importorskip("mjviser")


def listening(port: int) -> set[str]:
    """IPv4 addresses at which this computer listens on a port; empty for IPv6 alone."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    rows += [line.split() for line in Path("/proc/net/tcp6").read_text().splitlines()[1:]]
    found = set()
    for row in rows:
        address, hexadecimal = row[1].split(":")
        if int(hexadecimal, 16) == port and row[3] == "0A":
            found.add(socket.inet_ntoa(bytes.fromhex(address[-8:])[::-1]))
    return found


def test_the_robot_is_served_and_followed():
    model, ground = build_scene("stairs_up", 1)
    robot = MujocoRobot(model, robot_spec(), ground)
    viewer = BrowserViewer(model, robot.data, LOOPBACK)
    server = viewer._scene.server
    try:
        page = urlopen(f"http://localhost:{server.get_port()}", timeout=10).read()
        assert b"<html" in page.lower()
        assert server.get_host() == DeployCfg().host == "127.0.0.1"
        assert listening(server.get_port()) == {"127.0.0.1"}
        shown = []
        viewer._scene.update_from_mjdata = lambda data: shown.append(data.time)
        for step in range(5):
            robot.wait(0.02 * step)
            viewer.show()
        assert shown == pytest.approx([0.0, 0.04, 0.08])
    finally:
        server.stop()
