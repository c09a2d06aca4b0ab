import numpy as np
import pytest

from renet.bundle import Bundle
from renet.bundle.models import MODELS


def inputs(session, rows: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(0)
    shapes = {node.name: (rows, *node.shape[1:]) for node in session.get_inputs()}
    return {name: random.random(shape, np.float32) for name, shape in shapes.items()}


@pytest.mark.parametrize("model", MODELS)
def test_a_robots_results_depend_neither_on_the_others_nor_on_the_threads(model):
    alone = Bundle.load().sessions[model]
    names = [node.name for node in alone.get_outputs()][::-1]
    feed = inputs(alone, 70)
    expected = [np.asarray(output) for output in alone.run(names, feed)]
    for threads in (2, 3):
        session = Bundle.load(threads=threads).sessions[model]
        random = np.random.default_rng(threads)
        for count in (1, 2, 5, 31, 33, 70):
            rows = random.permutation(70)[:count]
            outputs = session.run(names, {name: value[rows] for name, value in feed.items()})
            for name, output, one in zip(names, outputs, expected, strict=True):
                np.testing.assert_array_equal(output, one[rows], f"{name}, {count} rows")
