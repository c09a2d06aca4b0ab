"""The camera-use study: policies that look at their camera, and policies that do not."""

from functools import partial

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.text import Text

from renet.evaluation.evaluator import Evaluator
from renet.evaluation.figures import STYLE
from renet.evaluation.studies import camera_use
from renet.evaluation.studies.camera_use import VIEWS, compare_with_twins, sentence

from ..fakes import FakeEnv


class Numbered(FakeEnv):
    """Robots that each see their own number, brighter to the right, and more with every step."""

    steps = 0

    def step(self, action):
        self.steps += 1
        return super().step(action)

    def result(self, speed, fell):
        result = super().result(speed, fell)
        images = np.arange(self.num_robots)[:, None, None] + np.linspace(0, 0.5, 64)
        result.depth[:] = images + 100 * self.steps
        return result


def test_each_view_shows_its_images():
    views = [view for view in VIEWS for _ in range(2)]
    env = camera_use.ShownImages(Numbered(24), views * 2, each=2)
    first = env.reset().depth[:, 0].astype(float)
    shown = env.step(np.zeros((24, 12), np.float32)).depth[:, 0].astype(float)
    row = {view: views.index(view) for view in VIEWS}
    for ground in (0, 12):  # The second ground's twins see nothing of the first.
        for view in ("healthy", "control"):
            assert shown[ground + row[view], 0] == 100 + ground + row[view]
        assert (shown[ground + row["blank"]] == 0).all()
        np.testing.assert_array_equal(shown[ground + row["frozen"]], first[ground + row["frozen"]])
        left = 100 + ground + row["mirrored"]
        assert tuple(shown[ground + row["mirrored"], [0, -1]]) == (left + 0.5, left)
        assert shown[ground + row["foreign"], 0] == 100 + ground + 1
        assert shown[ground + row["foreign"] + 1, 0] == 100 + ground, (
            "the last robot sees the first's"
        )


def rows(crossed: int, parted: int, robots: int = 40) -> dict:
    return {"crossed": np.arange(robots) < crossed, "parted": np.arange(robots) < parted}


@pytest.mark.parametrize(
    ("blank", "says"),
    [
        ((30, 0), "ignores its camera"),
        ((30, 2), "ignores its camera"),  # Two of forty are rounding, as in the control.
        ((30, 40), "who crosses changes no more than by chance"),
        ((25, 40), "who crosses changes no more than by chance"),  # 5 of 5: p = 0.06.
        ((10, 40), "30 of 40 robots cross, and 10 when they are shown black images (-50 points"),
    ],
)
def test_the_sentence_says_what_chance_does_not_explain(blank, says):
    part = dict.fromkeys(VIEWS, rows(30, 0)) | {"control": rows(30, 2), "blank": rows(*blank)}
    total = {view: compare_with_twins(part, view) for view in VIEWS}
    runs = [{"ground": "gap:3", "view": view} | row for view, row in total.items()]
    assert says in sentence(total, runs)
    assert ("On gap alone the difference" in sentence(total, runs)) == (blank[0] == 10)
    runs = [run | {"p": 1.0} for run in runs]
    assert ("On no ground alone" in sentence(total, runs)) == (blank[0] == 10)


def test_the_probability_is_the_sign_tests():
    part = dict.fromkeys(VIEWS, rows(30, 0)) | {"blank": rows(25, 0)}
    assert compare_with_twins(part, "blank")["p"] == pytest.approx(2 * 0.5**5)
    assert compare_with_twins(part, "blank")["change"] == pytest.approx(-5 / 40)


def test_the_sentence_stands_above_the_legend():
    rows = []
    for view in VIEWS:
        share = {"crossed_rate": 0.9, "crossed_ci95_low": 0.8, "crossed_ci95_high": 1.0}
        rows.append({"ground": "gap:3", "view": view, "mode": "camera"} | share)
    said = "This policy uses its camera: 20 of 20 robots cross, and 10 when they are shown black."
    with plt.rc_context(STYLE):
        drawn = camera_use.CameraUseStudy().draw({"runs": rows, "sentence": said}, {})
        figure = drawn["camera_use.png"]
        figure.canvas.draw()
    plt.close(figure)
    (legend,) = figure.legends
    shown = [text for text in figure.findobj(Text) if "This policy" in text.get_text()]
    assert " ".join(shown[0].get_text().split()) == said
    for name in legend.get_texts():
        assert name.get_window_extent().y1 <= shown[0].get_window_extent().y0


class Reader:
    """A stranger's policy without memory: it stands, and leans the more the darker its image."""

    def __init__(self, gain: float, num_robots: int) -> None:
        self.gain, self.anomaly_score = gain, np.zeros(num_robots)

    def reset(self, mask=None) -> None: ...

    def step(self, proprioception, depth, op_mask):
        lean = self.gain * (1 - depth.reshape(len(depth), -1).mean(axis=1, dtype=float))
        return np.repeat(lean[:, None], 12, axis=1).astype(np.float32)


@pytest.mark.parametrize(
    ("mode", "gain", "looks"),
    [("camera", None, True), ("blind", None, False), ("camera", 0.5, True), ("camera", 0.0, False)],
)
def test_two_policies_that_look_and_two_that_do_not(mode, gain, looks, tmp_path):
    evaluator = Evaluator(conditions="nominal")
    if gain is not None:
        evaluator.make_policy = partial(Reader, gain)  # type: ignore[method-assign]
    study = camera_use.CameraUseStudy(
        out=tmp_path,
        grounds=("gap:3",),
        modes=(mode,),
        robots=6,
        seconds=1.0,
        conditions="nominal",
    )
    summary = study.run(evaluator)
    assert ("ignores its camera" not in summary["sentence"]) == looks
    assert (summary["total"]["blank"]["parted"] > 4) == looks
    assert summary["total"]["control"]["parted"] == 0
    assert (tmp_path / "camera_use.png").stat().st_size > 10_000
