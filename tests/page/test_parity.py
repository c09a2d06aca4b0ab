"""The page's modules decide as the runtime does, on sequences that the runtime recorded."""

import base64
import json

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
from renet.interface import CONTROL_DT
from renet.page.writer import WEB
from tests.page.conftest import run_node

COMMAND, LATENTS = ("position", "stiffness", "damping"), ("latent_op", "latent_vp", "height_map")
NUMBERS = ("observation", "action", "anomaly", "probability", *COMMAND, *LATENTS)


def record(bundle: Bundle, terrain: str, fault: str, selector: str) -> tuple[list, list]:
    """Walk for 7.5 s; what the controller was given and what it decided, tick by tick."""
    model, ground = build_scene(terrain)
    robot = MujocoRobot(model, bundle.manifest.robot, ground)
    sensor = SimCamera(robot, bundle.manifest.camera, seed=4)
    camera = FaultyCamera(sensor, [parse_fault(fault)], robot.now, 5)
    controller = Controller(bundle, mode=selector)
    camera.start()
    due, shown, given, decided = robot.now(), None, [], []
    turn = 0.0
    for step in range(375):
        now, state, frame = robot.now(), robot.read(), camera.latest()
        turn_rate = 0.2 * np.cos(now) if now > 3.0 else 0.0
        teleop = TeleopCommand(forward=0.6, turn_rate=turn_rate, arm=step == 0)
        # The page counts the sum of all turns.
        turn += CONTROL_DT * turn_rate
        command = controller.tick(state, frame, teleop, now)
        fresh = None
        if frame is not shown:
            image = base64.b64encode(frame.image.astype("<f4").tobytes()).decode()
            fresh = {"image": image, "time": frame.time, "invalid": frame.invalid}
        seen = {
            "jointPosition": state.joint_position.tolist(),
            "jointVelocity": state.joint_velocity.tolist(),
            "quaternion": state.quaternion.tolist(),
            "angularVelocity": state.angular_velocity.tolist(),
        }
        speeds = {"speed": 0.6, "turn": turn, "arm": teleop.arm}
        given.append({"state": seen, "frame": fresh, "teleop": speeds, "now": now})
        decided.append(decision(controller) | {name: getattr(command, name) for name in COMMAND})
        robot.write(command)
        due, shown = next_step(robot, due), frame
    return given, decided


def decision(controller: Controller) -> dict:
    decision, policy = controller.decision, controller.policy
    (selector,) = controller.pilot.selectors.values()
    return {
        **{name: getattr(decision, name) for name in ("vision", "action", "anomaly")},
        **{name: getattr(policy, name)[0] for name in LATENTS},
        "probability": decision.probability,
        "mode": str(decision.mode),
        "reason": str(selector.reason[0]),
        "state": str(selector.state[0]),
        "observation": policy._history[0, -1].copy(),
    }


@pytest.mark.parametrize(
    ("terrain", "fault", "selector", "states"),
    [
        # Only a camera that is away for longer than the memory leaves OP in charge.
        ("flat", "gaussian:5@4s+2s", "memory", {"sees", "remembers", "blind"}),
        ("flat", "blackout:5@3s+3s", "memory", {"sees", "remembers", "blind"}),
        ("flat", "dropped:2@3s+3s", "memory", {"sees", "remembers"}),
        ("flat", "occlusion:4@3s+1s", "memory", {"sees", "remembers"}),
        ("flat", "unplugged:2@4s", "memory", {"sees", "remembers", "blind"}),
        ("platform", "frozen@3.5s", "memory", {"sees", "remembers", "blind"}),
        ("flat", "salt_and_pepper:5@4s+2s", "switch", {"sees", "blind"}),
    ],
)
def test_controller_decides_as_the_runtime(memory_page, tmp_path, terrain, fault, selector, states):
    bundle = Bundle.load(memory_page / "bundles" / "0")
    given, decided = record(bundle, terrain, fault, selector)
    (tmp_path / "sequence.json").write_text(json.dumps({"kind": selector, "ticks": given}))
    replayed = run_node("replay.mjs", WEB, memory_page, tmp_path / "sequence.json")
    modes = [one["mode"] for one in decided]
    assert [one["mode"] for one in replayed] == modes
    assert modes.count("walking") > 250
    assert {one["state"] for one in decided} == states
    for tick, (mine, its) in enumerate(zip(replayed, decided, strict=True)):
        walks = its["mode"] == "walking"
        for name in ("vision", "reason", "state") if walks else ():
            assert mine[name] == its[name], f"{name} at tick {tick}"
        for name in NUMBERS if walks else ("position",):
            message = f"{name} at tick {tick}"
            np.testing.assert_allclose(mine[name], its[name], atol=1e-4, err_msg=message)
