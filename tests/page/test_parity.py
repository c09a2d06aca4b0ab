"""The page's modules decide as the runtime does, on sequences that the runtime recorded."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from renet.bundle import Bundle
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.controller import Controller
from renet.deploy.loop import next_step
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.teleop import TeleopCommand
from renet.faults import parse_fault
from renet.page.writer import WEB
from tests.page.conftest import run_node

TOLERANCE = 1e-4
NUMBERS = (
    "observation", "action", "position", "stiffness", "damping", "latent_op", "latent_vp",
    "height_map", "anomaly", "probability",
)  # fmt: skip


class Recorder:
    """Walks the simulated robot, and keeps what its controller was given and what it decided."""

    def __init__(self, terrain: str, fault: str, selector: str, path: Path | None = None) -> None:
        bundle = Bundle.load(path)
        model, ground = build_scene(terrain)
        self.robot = MujocoRobot(model, bundle.manifest.robot, ground)
        camera = SimCamera(self.robot, bundle.manifest.camera, seed=4)
        self.camera = FaultyCamera(camera, [parse_fault(fault)], self.robot.now, 5)
        self.controller = Controller(bundle, selector=selector)
        self.kind, self.given, self.decided = selector, [], []

    def walk(self, seconds: float) -> None:
        self.camera.start()
        due, shown = self.robot.now(), None
        for step in range(round(seconds / 0.02)):
            now, state, frame = self.robot.now(), self.robot.read(), self.camera.latest()
            teleop = TeleopCommand(speed=0.6, turn=0.2 * np.sin(now), arm=step == 0)
            command = self.controller.tick(state, frame, teleop, now)
            new, shown = frame is not shown, frame
            self.given.append(
                {
                    "state": {
                        "jointPosition": state.joint_position.tolist(),
                        "jointVelocity": state.joint_velocity.tolist(),
                        "quaternion": state.quaternion.tolist(),
                        "angularVelocity": state.angular_velocity.tolist(),
                    },
                    "frame": _frame(frame) if new else None,
                    "teleop": {"speed": 0.6, "turn": teleop.turn, "arm": teleop.arm},
                    "now": now,
                }
            )
            self.decided.append(self._decision(command))
            self.robot.write(command)
            due = next_step(self.robot, due)

    def _decision(self, command) -> dict[str, Any]:
        decision, policy = self.controller.decision, self.controller.policy
        selector = self.controller._selector
        numbers = {name: getattr(command, name) for name in ("position", "stiffness", "damping")}
        for name in ("latent_op", "latent_vp", "height_map"):
            numbers[name] = getattr(policy, name)[0]
        for name in ("vision", "action", "anomaly", "probability"):
            numbers[name] = getattr(decision, name)
        return {
            **numbers,
            "mode": str(decision.mode),
            "reason": str(selector.reason[0]),
            "state": str(selector.state[0]),
            "observation": policy._history[0, -1].copy(),
        }


def _frame(frame) -> dict[str, Any]:
    image = base64.b64encode(frame.image.astype("<f4").tobytes()).decode()
    return {"image": image, "time": frame.time, "invalid": frame.invalid}


@pytest.mark.parametrize(
    ("terrain", "fault", "selector"),
    [
        ("flat", "gaussian:5@4s+2s", "monitors"),
        ("flat", "salt_and_pepper:5@4s+2s", "paper"),
        ("platform", "frozen@3.5s", "monitors"),
        ("flat", "unplugged:2@4s", "monitors"),
    ],
)
def test_controller_decides_as_the_runtime(node_page: Path, tmp_path, terrain, fault, selector):
    compare(Recorder(terrain, fault, selector), node_page, tmp_path / "sequence.json")


@pytest.mark.parametrize("fault", ["blackout:5@3s+3s", "dropped:4@3s+4s", "occlusion:4@3s+1s"])
def test_it_remembers_and_forgets_as_the_runtime(
    memory_page: Path, memory_bundle: Path, tmp_path, fault
):
    recorder = Recorder("flat", fault, "monitors", memory_bundle)
    compare(recorder, memory_page, tmp_path / "sequence.json")
    states = {d["state"] for d in recorder.decided}
    # Only a camera that is away for longer than the memory leaves OP in charge.
    assert states == {"sees", "remembers"} | ({"blind"} if "blackout" in fault else set())


def compare(recorder: Recorder, page: Path, sequence: Path) -> None:
    """Walk, replay what a recorder's controller was given, and expect what it decided."""
    recorder.walk(9.0)
    sequence.write_text(json.dumps({"kind": recorder.kind, "ticks": recorder.given}))
    replayed = run_node("replay.mjs", WEB, page, sequence)
    walking = [d["mode"] == "walking" for d in recorder.decided]
    assert [d["mode"] for d in replayed] == [d["mode"] for d in recorder.decided]
    assert sum(walking) > 300
    assert len({d["state"] for d in recorder.decided[150:]}) > 1
    for tick, (mine, its) in enumerate(zip(replayed, recorder.decided, strict=True)):
        walks = its["mode"] == "walking"
        for name in ("vision", "reason", "state") if walks else ():
            assert mine[name] == its[name], f"{name} at tick {tick}"
        for name in NUMBERS if walks else ("position",):
            message = f"{name} at tick {tick}"
            np.testing.assert_allclose(mine[name], its[name], atol=TOLERANCE, err_msg=message)
