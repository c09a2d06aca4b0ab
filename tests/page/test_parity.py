"""The page's modules decide as the runtime does, on sequences that the runtime recorded."""

import base64
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from renet.bundle import Bundle
from renet.deploy.cameras.faulty import FaultyCamera
from renet.deploy.cameras.sim import SimCamera
from renet.deploy.controller import Controller
from renet.deploy.loop import next_step
from renet.deploy.robots.sim.mujoco import MujocoRobot
from renet.deploy.robots.sim.scene import build_scene
from renet.deploy.teleop.base import TeleopCommand, Velocity
from renet.faults import parse_fault
from renet.interface import Unseen, proprioception_slices
from renet.page.writer import WEB
from tests.page.conftest import run_node

COMMAND, LATENTS = ("position", "stiffness", "damping"), ("latent_op", "latent_vp", "height_map")
SCORES = ("anomaly", "surprise", "stillness", "probability")
NUMBERS = ("observation", "action", *SCORES, *COMMAND, *LATENTS)


def record(
    bundle: Bundle,
    terrain: str,
    fault: str,
    mode: str,
    steer: Callable[[float], Velocity],
    unseen: Unseen = "walk",
) -> tuple[list, list]:
    """Walk for 7.5 s; what the controller was given and what it decided, tick by tick.

    `steer` gives the velocity that is asked for at a time in seconds.
    """
    model, ground = build_scene(terrain)
    robot = MujocoRobot(model, bundle.manifest.robot, ground)
    sensor = SimCamera(robot, bundle.manifest.camera, seed=4)
    camera = FaultyCamera(sensor, [parse_fault(fault)], robot.now, 5)
    controller = Controller(bundle, mode=mode, unseen=unseen)
    camera.start()
    due, shown, given, decided = robot.now(), None, [], []
    for step in range(375):
        now, state, frame = robot.now(), robot.read(), camera.latest()
        asked = steer(now)
        teleop = TeleopCommand(*asked, arm=step == 0)
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
        page_teleop = {
            "forward": asked.forward,
            "left": asked.left,
            "turnRate": asked.turn_rate,
            "arm": teleop.arm,
        }
        given.append({"state": seen, "frame": fresh, "teleop": page_teleop, "now": now})
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
        "surprise": float(policy.surprise[0]),
        "stillness": float(policy.stillness[0]),
        "probability": decision.probability,
        "phase": str(decision.mode),
        "reason": str(selector.reason[0]),
        "state": str(selector.state[0]),
        "unseen": bool(controller.pilot.unseen[0]),
        "map_seen": controller.pilot.map_seen[0].tolist(),
        "observation": policy._history[0, -1].copy(),
    }


@pytest.mark.parametrize(
    ("terrain", "fault", "mode", "states"),
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
def test_controller_decides_as_the_runtime(memory_page, tmp_path, terrain, fault, mode, states):
    bundle = Bundle.load(memory_page / "bundles" / "0")
    given, decided = record(bundle, terrain, fault, mode, ahead)
    assert {one["state"] for one in decided} == states
    compare(memory_page, tmp_path, mode, given, decided)


@pytest.mark.parametrize(("unseen", "speed"), [("slow", 0.3), ("stop", 0.0)])
def test_so_it_does_at_the_end_of_the_ground_seen(memory_page, tmp_path, unseen, speed):
    bundle = Bundle.load(memory_page / "bundles" / "0")
    given, decided = record(bundle, "flat", "unplugged:2@3s", "memory", ahead, unseen=unseen)
    compare(memory_page, tmp_path, "memory", given, decided, unseen)
    place = proprioception_slices()["command"]
    walked = [one for one in decided if one["phase"] == "walking" and one["unseen"]]
    slowest = min(one["observation"][place][0] for one in walked)
    assert slowest == pytest.approx(speed, abs=1e-6), "it came to the end of the ground seen"


@pytest.mark.parametrize("unseen", ["walk", "stop"])
def test_so_it_does_where_a_robot_has_never_seen(memory_page, tmp_path, unseen):
    bundle = Bundle.load(memory_page / "bundles" / "0")
    given, decided = record(bundle, "flat", "blackout@0s+4s", "memory", ahead, unseen=unseen)
    walked = [one for one in decided if one["phase"] == "walking"]
    assert walked[50]["unseen"]
    assert not any(walked[50]["map_seen"])
    compare(memory_page, tmp_path, "memory", given, decided, unseen)


def test_so_it_does_where_a_robot_stands_beyond_the_ground_seen(driven_page, tmp_path):
    bundle = Bundle.load(driven_page / "bundles" / "0")
    given, decided = record(bundle, "gap", "unplugged:2@3.2s", "memory", straight, unseen="stop")
    walked = [one for one in decided if one["phase"] == "walking"]
    assert any(one["state"] == "remembers" and not one["vision"] for one in walked), "OP drives"
    compare(driven_page, tmp_path, "memory", given, decided, "stop")


def test_so_it_does_where_a_policy_is_told_a_twist(driven_page, tmp_path):
    bundle = Bundle.load(driven_page / "bundles" / "0")
    assert bundle.manifest.told == "twist"
    given, decided = record(bundle, "flat", "gaussian:5@4s+2s", "memory", all_round)
    compare(driven_page, tmp_path, "memory", given, decided)
    place = proprioception_slices()["command"]
    told = np.array([one["observation"][place] for one in decided if one["phase"] == "walking"])
    assert told.min(axis=0) == pytest.approx([-0.6, -0.5, -1.0]), "backward and to the right"
    assert told[:, 1].max() == pytest.approx(0.3)
    corrected = (told[:, 0] == np.float32(0.6)) & (np.abs(told[:, 2]) > 1e-3)
    assert corrected.any(), "a heading is kept"


def test_so_it_does_where_a_policy_expects_images(surprised_page, tmp_path):
    bundle = Bundle.load(surprised_page / "bundles" / "0")
    given, decided = record(bundle, "stairs_up", "turned:5@4s+1s", "memory", ahead)
    surprises = [one["surprise"] for one in decided]
    assert min(surprises) < 0.3 < max(surprises), "the fault surprises"
    assert {one["state"] for one in decided} >= {"sees", "remembers"}
    reasons = {one["reason"] for one in decided}
    assert "the image contradicts what was seen before" in reasons
    compare(surprised_page, tmp_path, "memory", given, decided)


def test_so_it_does_where_a_vision_model_finds_images_that_stand_still(still_page, tmp_path):
    bundle = Bundle.load(still_page / "bundles" / "0")
    given, decided = record(bundle, "flat", "dropped:3@2s+2s", "memory", ahead)
    scores = [one["stillness"] for one in decided if np.isfinite(one["stillness"])]
    assert max(scores) - min(scores) > 0.1
    compare(still_page, tmp_path, "memory", given, decided)


def ahead(now: float) -> Velocity:
    """Ahead, later to both sides."""
    return Velocity(0.6, 0.0, 0.2 * np.cos(now) if now > 3.0 else 0.0)


def straight(now: float) -> Velocity:
    """Ahead."""
    return Velocity(0.6)


def all_round(now: float) -> Velocity:
    """Ahead, to the left, back and turning; beyond the limits at the end."""
    if now < 4.0:
        return Velocity(0.6)
    if now < 5.0:
        return Velocity(0.2, 0.3)
    return Velocity(-0.4, 0.0, 0.8) if now < 7.2 else Velocity(-9.0, -9.0, -9.0)


def compare(
    page: Path, folder: Path, mode: str, given: list, decided: list, unseen: Unseen = "walk"
) -> None:
    """Fail where the page's controller decides otherwise than the runtime's did."""
    sequence = {"mode": mode, "unseen": unseen, "ticks": given}
    (folder / "sequence.json").write_text(json.dumps(sequence))
    replayed = run_node("replay.mjs", WEB, page, folder / "sequence.json")
    phases = [one["phase"] for one in decided]
    assert [one["phase"] for one in replayed] == phases
    assert phases.count("walking") > 250
    for tick, (mine, its) in enumerate(zip(replayed, decided, strict=True)):
        walks = its["phase"] == "walking"
        for name in ("vision", "reason", "state", "unseen", "map_seen") if walks else ():
            assert mine[name] == its[name], f"{name} at tick {tick}"
        for name in NUMBERS if walks else ("position",):
            message = f"{name} at tick {tick}"
            # The two runtimes of ONNX add single precision in other orders.
            np.testing.assert_allclose(mine[name], its[name], rtol=1e-4, atol=1e-4, err_msg=message)
