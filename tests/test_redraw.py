"""tools/redraw.py: the documents' figures from the results."""

import json

import pytest
from PIL import Image

import redraw

FIGURES = redraw.ROOT / "docs" / "figures"


def test_an_unknown_figure_is_refused_with_those_that_there_are(capsys):
    with pytest.raises(SystemExit) as stop:
        redraw.parse_names(["memory", "gap"])
    assert stop.value.code == 2
    assert "no figure 'gap': choose among crossed" in capsys.readouterr().err
    assert redraw.parse_names(["memory"]) == ["memory"]
    assert redraw.parse_names([]) == []


@pytest.mark.parametrize("name", redraw.FIGURES)
def test_a_figure_is_drawn_with_the_origin_of_its_results(tmp_path, name):
    redraw.main([name], tmp_path)
    file, _ = redraw.FIGURES[name]
    made = json.loads((redraw.RESULTS / f"{file}.json").read_text())["provenance"]
    with Image.open(tmp_path / f"{name}.png") as new, Image.open(FIGURES / f"{name}.png") as shown:
        assert new.info["Description"] == shown.info["Description"]
        assert new.info["Description"].endswith(made["command"])
        assert new.size == shown.size


@pytest.mark.parametrize("path", sorted(FIGURES.glob("*.png")), ids=lambda path: path.stem)
def test_words_of_a_figure_are_legible_on_a_telephone(path):
    if path.stem == "filter":
        pytest.skip("of the measurements' notes, and wider")
    with Image.open(path) as figure:
        height_of_letters = 9 / 72 * figure.info["dpi"][0]
        assert height_of_letters * 358 / figure.width > 7.0


def test_intervals_follow_from_counts():
    bootstrap = {"crossed_ci95_low": 1.0, "crossed_ci95_high": 1.0}
    summary = {"runs": [{"robots": 20, "crossed": 20} | bootstrap], "robots": 20}
    exact = redraw.with_exact_intervals(summary, "crossed", "crossed")
    assert exact["robots"] == 20
    # Of n out of n, the lower limit p solves p^n = 0.025.
    assert exact["runs"][0]["crossed_ci95_low"] == pytest.approx(0.025 ** (1 / 20))
    assert exact["runs"][0]["crossed_ci95_high"] == 1.0
