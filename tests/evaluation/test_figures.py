"""Figures of names that come from files."""

import matplotlib.pyplot as plt
from PIL import Image

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
