"""The viewer in the browser: a real server, a real session, and every control pressed."""

import socket
import urllib.request

import numpy as np
import pytest
import viser
import zstandard
from websockets.sync.client import connect

from renet.errors import RenetError
from renet.evaluation.env import terrain_env_cfg
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.viewer.session import ViewerSession
from renet.evaluation.viewer.viewer import LiveViewer, serve, watch
from renet.faults import FAULTS, Injection
from renet.tasks.config.go1 import GO1
from renet.tasks.mdp.commands import goal
from renet.tasks.sensors import HEIGHT_MAP

HOST = "127.0.0.1"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def session():
    made = ViewerSession(Evaluator(), terrain_env_cfg("platform", 3, GO1), speed=0.5, seed=1)
    yield made
    made.close()


@pytest.fixture(scope="module")
def viewer(session):
    server = serve(HOST, free_port())
    made = LiveViewer(session, server)
    made.setup()
    yield made
    made.close()
    server.stop()


def advance(viewer: LiveViewer, steps: int) -> None:
    for _ in range(steps):
        assert viewer._execute_step(), viewer._last_error
        viewer.sync_env_to_viewer()


def unpacked(packet: bytes) -> bytes:
    """Viser's packets: two lengths of 8 bytes, then compressed messages, then arrays."""
    size = int.from_bytes(packet[8:16], "little")
    return zstandard.ZstdDecompressor().decompress(packet[16 : 16 + size])


def test_a_browser_gets_the_page_and_its_panels(viewer):
    address = f"{HOST}:{viewer._server.get_port()}"
    page = urllib.request.urlopen(f"http://{address}").read()
    assert b"<html" in page
    with connect(
        f"ws://{address}", subprotocols=[f"viser-v{viser.__version__}"], max_size=None
    ) as browser:
        received = b""
        while b"ground from above: predicted | true" not in received:
            received += unpacked(browser.recv(timeout=30))
    assert b"depth | reconstruction" in received


def test_panels_follow_the_robot(viewer, session):
    advance(viewer, 6)
    before = (viewer.panels.images.image, len(viewer.panels.loss.data[0]))
    advance(viewer, 5)
    panels, loop = viewer.panels, session.loop
    assert not np.array_equal(panels.images.image, before[0]), "a new depth image every tick"
    assert len(panels.loss.data[0]) == before[1] + 1
    assert panels.loss.data[1][-1] == pytest.approx(session.policy.anomaly_score[0])
    assert panels.trust.data[1][-1] == pytest.approx(loop.selector.probability[0])
    assert "VP · vision" in panels.status.content
    assert "camera: healthy" in panels.status.content


def test_the_true_map_shows_the_platform(viewer, session):
    viewer.reset_environment()
    session.env.sim.data.qpos[0, 0] = session.env.scene.env_origins[0, 0] + 1.05
    advance(viewer, 6)
    # Its edge is 0.35 m away, which is on the map whichever way the robot looks: 0.15 m at level 3.
    true = session.env.scene[HEIGHT_MAP].data[0].numpy()
    assert np.ptp(true) == pytest.approx(0.15, abs=0.01)
    true = viewer.panels.maps.image[:, -176:]
    assert np.ptp(true.reshape(-1, 3), axis=0).max() > 0


def test_every_fault_has_a_button_that_breaks_the_camera(viewer, session):
    assert set(viewer.panels.faults) == set(FAULTS)
    for name, button in viewer.panels.faults.items():
        button.value = True
        advance(viewer, 5)
        assert session.fault == name
        assert f"camera: {name.replace('_', ' ')}" in viewer.panels.status.content
    viewer.panels.clear_fault.value = True
    advance(viewer, 5)
    assert session.fault == ""
    session.inject(Injection.of("frozen", 1, onset=0))
    advance(viewer, 9)
    assert session.fault == "frozen"
    advance(viewer, 2)
    assert session.fault == "", "it ends by itself after 0.2 s"


def test_noise_hands_over_to_op_and_the_panels_say_why(viewer, session):
    viewer.reset_environment()
    viewer.panels.severity.value = 5
    viewer.panels.faults["gaussian"].value = True
    advance(viewer, 15)
    assert session.policy.anomaly_score[0] > session.beta
    assert session.loop.selector.probability[0] < 0.5
    assert session.loop.use_op[0]
    assert "OP · blind" in viewer.panels.status.content
    assert "vision is not trusted" in viewer.panels.status.content
    viewer.panels.clear_fault.value = True
    viewer.panels.mode.value = "vp"
    advance(viewer, 1)
    assert not session.loop.use_op[0], "vision is forced"
    viewer.panels.mode.value = "renet"


def test_speed_and_turn_reach_the_command(viewer, session):
    viewer.reset_environment()
    command = goal(session.env)
    yaw = command.yaw.item()
    viewer.panels.speed.value = 0.0
    viewer.panels.turn.value = "left"
    advance(viewer, 1)
    assert command.command[0, 0] == 0.0
    assert command.yaw.item() - yaw == pytest.approx(np.pi / 6)
    viewer.reset_environment()
    assert command.speed.item() == 0.0, "a reset keeps the speed that was asked for"
    assert len(viewer.panels._points) == 0, "and begins new curves"


def test_a_fall_restarts_policy_and_selector(viewer, session):
    viewer.reset_environment()
    viewer.panels.faults["gaussian"].value = True
    advance(viewer, 15)
    session.env.sim.data.qpos[0, 3:7] = session.env.sim.data.qpos.new_tensor([0.0, 1.0, 0.0, 0.0])
    advance(viewer, 1)
    assert (session.policy.latent_op == 0.0).all()
    assert session.loop.selector.probability[0] == 1.0


def test_a_taken_port_is_named(session):
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(RenetError, match=f"{port}.*choose --port"):
            watch(session, HOST, port)


def test_watch_runs_and_says_where(capsys):
    made = ViewerSession(Evaluator(), terrain_env_cfg("flat", 1, GO1), speed=0.5, seed=1)
    port = free_port()
    watch(made, HOST, port, steps=3)
    assert f"http://{HOST}:{port}" in capsys.readouterr().out
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(f"http://{HOST}:{port}")
