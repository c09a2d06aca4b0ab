"""Actions of recorded walks, modes, batches, and a camera that stops.

`data/walks.npz` are two walks of the shipped Go1 bundle in MuJoCo, with the actions of the
controller as it was before there was a pilot: `memory` meets a blackout after two seconds, `switch`
salt and pepper.
"""

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import renet
from renet.bundle import Bundle, write_bundle
from renet.errors import RenetError
from renet.interface import CONTROL_DT, STEPS_PER_TICK
from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.pilot import PILOT_MODES, Images, Pilot
from renet.pilot.inference import InlineInference
from renet.pilot.policy import BundlePolicy
from renet.pilot.tick import EstimatorOutput
from renet.training.export import export_models

WALKS = np.load(Path(__file__).with_name("data") / "walks.npz")
STILL = np.zeros((1, 45), np.float32)


@pytest.fixture(scope="module")
def shipped() -> Bundle:
    return Bundle.load()


def forgetful(bundle: Bundle, longest_memory: float) -> Bundle:
    """The bundle with another length of its memory, s."""
    selector = replace(bundle.manifest.selector, longest_memory=longest_memory)
    return replace(bundle, manifest=replace(bundle.manifest, selector=selector))


def ground(step: int) -> np.ndarray:
    """The image [1, 48, 64] of a healthy camera at a step of the recorded walk, below 100."""
    return WALKS["memory_images"][step // STEPS_PER_TICK][None].astype(np.float32) / 255


def observed(step: int) -> np.ndarray:
    """The observation [1, 45] at that step."""
    return WALKS["memory_observation"][step][None]


def recorded(name: str):
    """Observation, image (None where no new one came), time, action and state of each step."""
    walk = {part: WALKS[f"{name}_{part}"] for part in ("observation", "now", "action", "state")}
    numbers = WALKS[f"{name}_image"]
    images = WALKS[f"{name}_images"].astype(np.float32) / 255
    fresh = np.diff(numbers, prepend=-1) > 0
    for step, (observation, now, action, state) in enumerate(zip(*walk.values(), strict=True)):
        image = images[numbers[step]] if fresh[step] else None
        yield observation, image, now, action, state


@pytest.mark.parametrize("mode", ["memory", "switch"])
def test_recorded_walks_give_the_recorded_actions(mode):
    pilot = renet.load("go1-parkour", mode=mode)
    states = []
    for observation, image, now, action, state in recorded(mode):
        step = pilot.step(observation[None], None if image is None else image[None], now)
        np.testing.assert_allclose(step.action[0], action, atol=1e-5)
        assert step.state[0] == state
        states.append(state)
    assert set(states) == {"sees", "remembers" if mode == "memory" else "blind"}


def test_several_robots_do_what_each_does_alone(shipped):
    modes = ["memory", "switch", "camera", "blind", "memory"]
    together = Pilot.of(shipped, robots=5, mode=modes)
    alone = [Pilot.of(shipped, mode=mode) for mode in modes]
    walks = list(zip(recorded("memory"), recorded("switch"), strict=True))
    seen = set()
    for number, (one, other) in enumerate(walks):
        rows = [one, other, one, other, other]
        image = None if one[1] is None else np.stack([row[1] for row in rows])
        observation = np.stack([row[0] for row in rows])
        if number == 60:
            again = np.arange(5) == 4
            together.reset(again)
            alone[4].reset(np.ones(1, bool))
        step = together.step(observation, image, one[2])
        for robot, pilot in enumerate(alone):
            each = slice(robot, robot + 1)
            mine = pilot.step(observation[each], None if image is None else image[each], one[2])
            np.testing.assert_allclose(step.joint_target[each], mine.joint_target, atol=1e-5)
            for name in ("vision", "state", "reason"):
                np.testing.assert_array_equal(getattr(step, name)[each], getattr(mine, name))
        seen |= set(step.state)
    assert seen == {"sees", "remembers", "blind"}


def test_it_remembers_and_then_is_blind_as_images_stop(shipped):
    pilot = Pilot.of(forgetful(shipped, longest_memory=1.0))
    begins = {}
    for number in range(120):
        new = number % STEPS_PER_TICK == 0 and number < 30
        step = pilot.step(observed(number), ground(number) if new else None, number * CONTROL_DT)
        begins.setdefault(str(step.state[0]), number)
        # An image that is late by a tick is no reason yet.
        assert step.reason[0].startswith("no new image" if number >= 35 else "")
        assert (step.reason[0] == "") == (number < 35)
    assert list(begins) == ["sees", "remembers", "blind"]
    assert step.reason[0] == "no new image for 1 s, as long as it remembers"
    # The last image comes at step 25, and VP has it until the tick of step 30.
    assert begins["remembers"] == 30
    assert begins["blind"] == pytest.approx(30 + 1.0 / CONTROL_DT, abs=3)
    assert not step.vision[0]


def test_each_mode_is_driven_by_the_estimator_it_names(shipped):
    pilot = Pilot.of(shipped, robots=4, mode=PILOT_MODES)
    vision, states = [], []
    for number in range(60):
        image = np.repeat(ground(number), 4, axis=0)
        if number >= 30:
            image[:] = np.random.default_rng(number).random(image.shape) > 0.5
        image = image if number % STEPS_PER_TICK == 0 else None
        observation = np.repeat(observed(number), 4, axis=0)
        step = pilot.step(observation, image, number * CONTROL_DT)
        vision.append(step.vision.tolist())
        states.append(step.state.tolist())
    assert pilot.modes.tolist() == ["memory", "switch", "camera", "blind"]
    assert vision[29] == [True, True, True, False]
    assert states[29] == ["sees", "sees", "sees", "blind"]
    assert vision[-1] == [True, False, True, False]
    assert states[-1] == ["remembers", "blind", "sees", "blind"]


def test_without_a_camera_it_walks_blind(shipped):
    for mode in PILOT_MODES:
        pilot = Pilot.of(shipped, mode=mode)
        for number in range(20):
            step = pilot.step(STILL, None, number * CONTROL_DT)
            assert not step.vision[0]
        assert step.state[0] == "blind"
        assert np.isfinite(step.joint_target).all()


@pytest.mark.parametrize("mode", PILOT_MODES)
def test_a_walk_that_begins_without_an_image_says_why_it_is_blind(shipped, mode):
    pilot = Pilot.of(shipped, mode=mode)
    told = []
    for number in range(120):
        image = ground(number % 100) if number >= 30 and number % STEPS_PER_TICK == 0 else None
        step = pilot.step(observed(number % 100), image, number * CONTROL_DT)
        told.append((str(step.state[0]), str(step.reason[0])))
    waits = ("blind", "no image has come yet")
    catches_up = ("blind", "it began without an image")
    expected = {
        "memory": [waits, catches_up, ("sees", "")],
        "switch": [waits, catches_up, ("sees", "")],
        "camera": [waits, ("sees", "")],
        "blind": [("blind", "the mode blind uses no images")],
    }
    assert list(dict.fromkeys(told)) == expected[mode]
    assert mode == "blind" or told[29:31] != [waits, waits]
    pilot.reset()
    first = pilot.step(observed(0), ground(0), 0.0)
    assert mode == "blind" or (first.state[0], first.reason[0]) == ("sees", "")


def test_an_image_between_two_ticks_is_seen_in_the_next(shipped):
    pilot = Pilot.of(shipped)
    for number in range(16):
        image = ground(number) if number in (0, 3, 8) else None
        step = pilot.step(observed(number), image, number * CONTROL_DT)
        # None has come by the tick of step 15.
        assert step.state[0] == ("sees" if number < 15 else "remembers")


def test_reset_begins_anew(shipped):
    pilot = Pilot.of(shipped)
    first = pilot.step(observed(0), ground(0), 0.0)
    for number in range(1, 43):
        image = np.ones((1, 48, 64)) if number % STEPS_PER_TICK == 0 else None
        step = pilot.step(observed(number), image, number * CONTROL_DT)
    assert step.state[0] == "remembers"
    pilot.reset()
    assert pilot.due
    again = pilot.step(observed(0), ground(0), 43 * CONTROL_DT)
    np.testing.assert_array_equal(again.action, first.action)
    assert again.state[0] == "sees"


@pytest.mark.parametrize(
    ("observation", "image", "message"),
    [
        (np.zeros((1, 44)), None, r"the observation has shape \(1, 44\), expected \(1, 45\)"),
        (np.zeros(45), None, r"the observation has shape \(45,\), expected \(1, 45\)"),
        (np.full((1, 45), np.nan), None, "the observation contains NaN"),
        (STILL, np.ones((48, 64)), r"image has shape \(48, 64\), expected \(1, 48, 64\)"),
        (STILL, np.full((1, 48, 64), 850.0), "divide metres by 2 and clip"),
    ],
)
def test_wrong_input_is_refused_in_one_line_and_changes_nothing(
    shipped, observation, image, message
):
    pilot = Pilot.of(shipped)
    untouched = Pilot.of(shipped)
    with pytest.raises(RenetError, match=message) as refused:
        pilot.step(observation, image, 0.0)
    assert "\n" not in str(refused.value)
    after = [one.step(STILL, ground(0), 0.02) for one in (pilot, untouched)]
    np.testing.assert_array_equal(after[0].action, after[1].action)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.full((1, 48, 64), 850.0), "divide metres by 2 and clip"),
        (np.full((1, 48, 64), np.nan), "the depth image contains NaN"),
        (np.ones((1, 64, 48)), r"image has shape \(1, 64, 48\), expected \(1, 48, 64\)"),
    ],
)
def test_wrong_images_with_ages_are_refused_and_change_nothing(shipped, image, message):
    """The images of later ticks are judged, and blank ones withheld, as ever."""
    pilot = Pilot.of(shipped)
    untouched = Pilot.of(shipped)
    whole = Images(ground(0), np.ones(1, bool), np.zeros(1), np.zeros(1))
    with pytest.raises(RenetError, match=message):
        pilot.step(STILL, replace(whole, image=image), 0.0)
    for number in range(1, 20):
        blank = replace(whole, image=np.full((1, 48, 64), 0.5), fresh=np.array([number % 5 == 1]))
        for one in (pilot, untouched):
            step = one.step(STILL, blank, number * CONTROL_DT)
            assert step.state[0] != "sees"
            assert not one.policy.has_image[0]
        assert pilot.due == untouched.due


@pytest.mark.parametrize(
    ("now", "message"),
    [
        (0.98, "the time now is 0.980 s, expected at least the 1.000 s of the step before"),
        (np.nan, "the time now is nan, expected a finite number of seconds"),
        (np.inf, "the time now is inf, expected a finite number of seconds"),
    ],
)
def test_time_that_runs_back_is_refused_and_changes_nothing(shipped, now, message):
    pilot = Pilot.of(shipped)
    untouched = Pilot.of(shipped)
    for one in (pilot, untouched):
        one.step(observed(0), ground(0), 1.0)
    with pytest.raises(RenetError, match=message) as refused:
        pilot.step(observed(1), ground(5), now)
    assert "\n" not in str(refused.value)
    after = [one.step(observed(1), None, 1.02) for one in (pilot, untouched)]
    np.testing.assert_array_equal(after[0].action, after[1].action)


class LateInference(InlineInference):
    """Gives the results of a tick one control step later."""

    late = True

    def take(self) -> EstimatorOutput | None:
        self.late = not self.late
        return super().take() if self.late else None


def test_selectors_are_told_that_scores_are_late(shipped):
    images = Images(ground(0), np.ones(1, bool), np.zeros(1), np.zeros(1))
    policy = BundlePolicy(shipped, inference=LateInference)
    for pilot, scored in (
        (Pilot.of(shipped), [True]),
        (Pilot.of(shipped, policy=policy), [False, True]),
    ):
        found = []
        for step in range(len(scored)):
            pilot.act(observed(step), images)
            found.append(pilot.seen(images).scored)
        assert found == scored


def test_time_may_stand_still_and_begin_anew_after_a_reset(shipped):
    pilot = Pilot.of(shipped)
    for now in (1.0, 1.0, 1.02):
        pilot.step(STILL, ground(0), now)
    pilot.reset(np.ones(1, bool))
    with pytest.raises(RenetError, match="reset"):
        pilot.step(STILL, ground(0), 0.0)
    pilot.reset()
    pilot.step(STILL, ground(0), 0.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"bundle": "go3-parkour"}, "no bundle at go3-parkour"),
        ({"mode": "paper"}, "mode"),
        ({"robots": 0}, "robots must be at least 1"),
        ({"robots": 3, "mode": ["memory", "blind"]}, "2 modes for 3 robots"),
    ],
)
def test_what_cannot_be_loaded_is_refused(arguments, message):
    with pytest.raises(RenetError, match=message):
        renet.load(**arguments)


def test_a_broken_frame_counts_against_the_papers_switch(shipped):
    pilot = Pilot.of(shipped, mode="switch")
    whole = Images(ground(0), np.ones(1, bool), np.zeros(1), np.zeros(1))
    for number in range(10):
        broken = replace(whole, broken=np.array([number >= 5]))
        step = pilot.step(STILL, broken, number * CONTROL_DT)
        assert step.vision[0] == (number < 7)


def test_importing_renet_needs_neither_torch_nor_onnx():
    code = "import sys, renet; print({'torch', 'onnxruntime', 'numpy'} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.mark.parametrize("mode", PILOT_MODES)
def test_an_old_image_is_no_evidence_of_stillness_in_any_mode(manifest, tmp_path, mode):
    networks = RENet(ModelCfg(detector="variance", expect_image=True), critic_size=10).eval()
    path = write_bundle(tmp_path / "expecting", export_models(networks), manifest)
    pilot = renet.load(path, mode=mode)
    random = np.random.default_rng(0)
    evidence = []
    for step in range(60):
        # An image at every second tick.
        image = random.random((1, 48, 64)) if step % 10 == 0 else None
        pilot.step(random.normal(size=(1, 45)), image, 0.02 * step)
        evidence.append(pilot.policy.evidence[0].tolist())
    ticks = evidence[::5]
    changed = [now != before for before, now in pairwise(ticks)]
    assert not any(changed[::2])
    assert all(changed[3::2])
