"""The browser viewer serves the simulated robot."""

import socket
from urllib.request import urlopen

import pytest

from renet.deploy.catalogue import SimulationCfg
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.robots.sim.viewer import BrowserViewer
from renet.server import LOOPBACK
from renet.training.export import robot_spec

pytest.importorskip("mjviser")


def test_the_robot_is_served_and_followed():
    model, ground = build_scene("stairs_up", 1)
    robot = MujocoRobot(model, robot_spec(), ground)
    viewer = BrowserViewer(model, robot.data, SimulationCfg().host)
    server = viewer._scene.server
    try:
        assert server.get_host() == SimulationCfg().host == LOOPBACK
        page = urlopen(f"http://127.0.0.1:{server.get_port()}", timeout=10).read()
        assert b"<html" in page.lower()
        with pytest.raises(ConnectionRefusedError):  # As at any other address of this computer.
            socket.create_connection(("127.0.0.2", server.get_port()), timeout=10)
        shown = []
        viewer._scene.update_from_mjdata = lambda data: shown.append(data.time)
        for step in range(5):
            robot.wait(0.02 * step)
            viewer.show()
        assert shown == pytest.approx([0.0, 0.04, 0.08])
    finally:
        server.stop()
