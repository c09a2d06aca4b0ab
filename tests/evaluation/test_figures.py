"""Figures of names that come from files."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image, ImageColor

from renet.evaluation import figures
from renet.evaluation.results import Provenance

ODD = r"my $\frac{bundle$ <b>"


def test_a_name_that_looks_like_a_formula_is_drawn_as_it_is(tmp_path):
    provenance = Provenance(ODD, "0" * 64, "native", 1, command=f"renet evaluate --bundle {ODD}")
    with plt.rc_context(figures.STYLE):
        figure, axis = plt.subplots()
        axis.plot([0, 1], label=ODD)
        axis.set_title(ODD)
        figures.legend(figure, axis)
        path = figures.save_figure(figure, tmp_path / "odd.png", provenance)
    assert ODD in Image.open(path).text["Description"]


@pytest.mark.parametrize("columns", ["5", "12345"])
def test_titles_of_coloured_tables_are_within_the_figure_and_apart(columns):
    names = ("monitors of mode memory", "rule of mode switch")
    cells = {("blackout", severity): (50.0, "50") for severity in columns}
    title = "Robots with vision that noticed the fault while it lasted (%)"
    with plt.rc_context(figures.STYLE):
        figure = figures.colour_tables(dict.fromkeys(names, cells), title, "severity")
        figure.canvas.draw()
        texts = {" ".join(text.get_text().split()): text for text in figure.findobj(Text)}
        first, second, whole = (texts[name].get_window_extent() for name in (*names, title))
    plt.close(figure)
    assert first.x1 < second.x0
    assert max(second.x1, whole.x1) <= figure.bbox.x1


@pytest.mark.parametrize("limits", [(2e-4, 0.7), (0.2, 0.7)])
def test_ticks_of_a_logarithmic_axis_are_plain_numbers(limits):
    with plt.rc_context(figures.STYLE):
        figure, axis = plt.subplots()
        axis.set(yscale="log", ylim=limits)
        figures.label_log_ticks(axis.yaxis)
        figure.canvas.draw()
    plt.close(figure)
    labels = [label.get_text() for label in axis.get_yticklabels(which="both")]
    values = [float(label.replace("−", "-")) for label in labels if label]
    assert len(values) >= 2
    assert all(limits[0] / 10 <= value <= limits[1] * 10 for value in values)


def test_a_legend_of_long_names_is_within_the_figure_and_names_each_once():
    names = [f"2026-09-21_10-11-12_recipe_{number}" for number in range(4)]
    with plt.rc_context(figures.STYLE):
        figure, axes = plt.subplots(2, 1, figsize=(4.2, 3.4))
        for axis in axes:
            for name in names:
                axis.plot([0, 1], label=name)
        figures.legend(figure, *axes)
        figure.canvas.draw()
        (legend,) = figure.legends
        box = legend.get_window_extent()
    plt.close(figure)
    assert [text.get_text() for text in legend.get_texts()] == names
    assert box.x0 >= 0.0
    assert box.x1 <= figure.bbox.x1


def test_a_figure_is_a_card_whose_corners_show_the_page(tmp_path):
    with plt.rc_context(figures.STYLE):
        figure, axis = plt.subplots()
        axis.set_title("card")
        path = figures.save_figure(figure, tmp_path / "card.png", Provenance("b", "0", "native", 1))
    picture = np.asarray(Image.open(path))
    edges = picture[:, 0], picture[:, -1], picture[0], picture[-1]
    card = [*ImageColor.getrgb(figures.BACKGROUND), 255]
    for edge in edges:
        assert edge[0, 3] == edge[-1, 3] == 0
        assert (edge[40:-40] == card).all()


def test_a_long_last_line_is_within_the_figure():
    long = Provenance(
        "b", "0" * 64, "native", 1, command="renet evaluate " + "--modes camera " * 12
    )
    with plt.rc_context(figures.STYLE):
        figure, _ = plt.subplots(figsize=(figures.FIGURE_WIDTH, 2.0))
        figures.add_footer(figure, long)
        figure.canvas.draw()
        right = figure._supxlabel.get_window_extent().x1  # type: ignore[attr-defined]
    plt.close(figure)
    assert right < figure.bbox.x1


def test_shares_are_drawn_in_percent_with_their_intervals():
    run = {"fell_rate": 0.2, "fell_ci95_low": 0.1, "fell_ci95_high": 0.5}
    figure, axis = plt.subplots()
    figures.draw_shares(axis, [3.0], [run], "fell")
    (line,) = axis.lines
    (interval,) = axis.collections[0].get_segments()
    plt.close(figure)
    np.testing.assert_allclose(line.get_xydata(), [(3.0, 20.0)])
    np.testing.assert_allclose(interval, [(3.0, 10.0), (3.0, 50.0)])
