"""Films: a real short one, and the mistakes that stop one before it begins."""

from __future__ import annotations

import pytest

from renet.errors import RenetError
from renet.evaluation.play import PlayCfg, run_play


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"terrain": "lava"}, "unknown terrain 'lava'"),
        ({"terrain": "gap", "level": 11}, "1 to 10"),
        ({"fault": "gremlins"}, "unknown fault 'gremlins'"),
        ({"modes": ("eyes",)}, "unknown mode 'eyes'"),
        ({"seconds": 0.1}, "at least one second"),
    ],
)
def test_mistakes_are_named_before_anything_is_written(tmp_path, fields, message):
    with pytest.raises(RenetError, match=message):
        run_play(PlayCfg(out=tmp_path / "film.mp4", **fields))
    assert not list(tmp_path.iterdir())


def test_a_second_on_a_tile_makes_a_film(tmp_path):
    cfg = PlayCfg(
        out=tmp_path / "film.mp4", terrain="platform", fault="gaussian", onset=0.5, seconds=1.0
    )
    assert run_play(cfg).stat().st_size > 1000
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
