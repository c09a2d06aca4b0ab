from itertools import pairwise

import numpy as np
import pytest

from renet.faults import FAULTS, SEVERITIES, TICK, Frames
from renet.interface import DEPTH_SHAPE

INTERMITTENT = ("intermittent_blackout", "intermittent_frozen", "intermittent_glare")


def image(tick: int) -> np.ndarray:
    return np.random.default_rng(tick).uniform(0.2, 0.9, (2, *DEPTH_SHAPE)).astype(np.float32)


def play(name: str, level: float, ticks: int = 40, begins: int = 5) -> list[Frames]:
    fault = FAULTS[name](level, [np.random.default_rng(n) for n in range(2)])
    out = []
    for t in range(ticks):
        elapsed = (t - begins) * TICK if t >= begins else -1.0
        out.append(fault.corrupt(Frames.healthy(image(t)), np.full(2, elapsed)))
    return out


@pytest.mark.parametrize("name", INTERMITTENT)
@pytest.mark.parametrize("severity", SEVERITIES)
def test_is_on_for_the_stated_part_of_every_second(name: str, severity: int) -> None:
    share = FAULTS[name].level_of(severity)
    frames = play(name, share)
    spoilt = [bool((f.image != image(t)).any()) for t, f in enumerate(frames)]
    expected = [t >= 5 and (t - 5) % 10 < round(10 * share) for t in range(40)]
    assert spoilt == expected


def test_each_freeze_holds_the_last_image_before_it() -> None:
    frames = play("intermittent_frozen", 0.3)
    for onset in (5, 15, 25):
        for t in range(onset, onset + 3):
            np.testing.assert_array_equal(frames[t].image, image(onset - 1))


def test_lost_frames_show_the_glare_of_the_last_delivered_one() -> None:
    frames = play("glare_dropped", 4)[5:]
    glare = FAULTS["glare"].level_of(4)
    assert all(f.invalid[f.fresh] == pytest.approx(glare, abs=1e-3) for f in frames)
    lost = 1 - np.mean([f.fresh for f in frames])
    assert lost == pytest.approx(FAULTS["dropped"].level_of(4), abs=0.15)
    for before, after in pairwise(frames):
        held = ~after.fresh
        np.testing.assert_array_equal(after.image[held], before.image[held])


def test_two_faults_spoil_what_both_alone_spoil() -> None:
    frames = play("blobs_latency", 5)
    blobs = play("blobs", FAULTS["blobs"].level_of(5))
    dirty = blobs[5].image != image(5)
    late = frames[30].image
    # Pixels of the lens are covered, and the ground beside them is one of an earlier frame.
    assert (late[dirty] <= 0.1 + 1e-6).mean() > 0.95
    clean = ~dirty[0]
    matches = [k for k in range(31) if np.array_equal(late[0][clean], image(k)[0][clean])]
    assert matches[0] < 30


def test_levels_name_both_parts() -> None:
    assert FAULTS["glare_dropped"].describe(3) == "30 % + 50 %"
