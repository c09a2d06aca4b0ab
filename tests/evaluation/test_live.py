"""Where robots are watched: who gets a window, what it shows, how a watched walk ends."""

import shutil
import subprocess
import sys
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from renet.errors import RenetError
from renet.evaluation import live
from renet.evaluation.play import PlayCfg, watching
from renet.interface import CONTROL_DT
from renet.robots import GO1

pytestmark = pytest.mark.wall_clock


@pytest.fixture
def spec() -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_file(str(GO1.mjcf))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1])
    return spec


@pytest.fixture
def no_display(monkeypatch) -> None:
    for name in live.DISPLAYS:
        monkeypatch.delenv(name, raising=False)


@pytest.mark.usefixtures("no_display")
def test_without_a_display_nobody_watches_unless_asked(spec):
    assert live.open_view("auto", spec, ("camera",)) is None
    assert live.open_view("none", spec, ("camera",)) is None
    with pytest.raises(RenetError, match=r"no display .* take --viewer browser"):
        live.open_view("window", spec, ("camera",))


def test_a_display_that_cannot_be_reached_is_none(spec, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(live, "_starts_windows", lambda: False)
    assert live.open_view("auto", spec, ("camera",)) is None
    with pytest.raises(RenetError, match="no display"):
        live.open_view("window", spec, ("camera",))


class Watched:
    """An environment and a view at once, closed after the fourth control step."""

    def __init__(self) -> None:
        self.shown: list[np.ndarray] = []
        self.ended = False
        self.scene_spec = None

    def poses(self, rows):
        return np.full((len(rows), 19), float(len(self.shown)))

    @property
    def closed(self) -> bool:
        return len(self.shown) == 3

    def show(self, poses: np.ndarray) -> None:
        self.shown.append(poses)

    def close(self) -> None:
        self.ended = True


def test_a_walk_is_shown_at_the_clocks_pace_until_the_window_is_closed(monkeypatch):
    view, now = Watched(), [10.0]
    clock = SimpleNamespace(
        monotonic=lambda: now[0], sleep=lambda seconds: now.append(now.pop() + seconds)
    )
    monkeypatch.setattr(live, "time", clock)
    monkeypatch.setattr("renet.evaluation.play.open_view", lambda *_: view)
    with watching(PlayCfg(), view, ("switch", "memory")) as on_step:
        ends = [on_step(step) for step in range(6)]
    assert ends == [False] * 4 + [True] * 2
    assert [poses.shape for poses in view.shown] == [(2, 19)] * 3
    assert view.ended
    assert now[0] == pytest.approx(10.0 + 6 * CONTROL_DT)


WINDOW = """
import mujoco, numpy as np
from renet.robots import GO1
from renet.evaluation.live import open_view
spec = mujoco.MjSpec.from_file(str(GO1.mjcf))
view = open_view("window", spec, ("switch", "memory"))
pose = view._model.qpos0
view.show(np.stack([pose + 0.1, pose]))
print(view._window.user_scn.ngeom, view._window.user_scn.geoms[0].label, view.closed)
view.close()
"""


@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="needs a display, or Xvfb")
def test_a_real_window_shows_a_robot_and_its_ghost():
    command = ["xvfb-run", "-a", sys.executable, "-c", WINDOW]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    geoms, label, closed = done.stdout.split()
    assert int(geoms) > 10, done.stderr
    assert (label, closed) == ("switch", "False")
