"""Films: a real short one, and the mistakes that stop one before it begins."""

import subprocess
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from renet.bundle import Bundle, pretrained
from renet.cli import main
from renet.errors import RenetError
from renet.evaluation import painter, video
from renet.evaluation.env import trained_env_cfg
from renet.evaluation.play import PlayCfg, bundle_folder, open_evaluator, run_play
from renet.robots import GO1
from renet.tasks import VISUAL_GO1
from tests.evaluation.policies import joint_model, save_model, write_adapter

CHECKPOINT = pretrained("checkpoint")
THEIRS = {"policy": Path("mine.onnx"), "adapter": "onnx-depth"}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"terrain": "lava"}, "unknown terrain 'lava'"),
        ({"terrain": "gap", "level": 11}, "1 to 10"),
        ({"scene": Path("nowhere.npy")}, "cannot read the height map nowhere.npy"),
        ({"scene": Path("nowhere.obj")}, "nowhere.obj is no ground"),
        ({"fault": ("gremlins@1s",)}, "unknown fault 'gremlins'"),
        ({"modes": ("eyes",)}, "modes eyes: choose"),
        ({"seconds": 0.1}, "at least one second"),
        ({"out": Path("film")}, "a film is an .mp4: give --out film.mp4"),
        ({"out": Path("film.MP4"), "seconds": 0.1}, "at least one second"),
        ({"bundle": Path("nowhere")}, "nowhere"),
        ({"bundle": Path(__file__).parent}, "no checkpoint"),
        ({"bundle": Path(__file__)}, "`renet evaluate log` draws a recording"),
        ({"policy": Path("mine.onnx")}, "give --policy FILE and --adapter together"),
        (THEIRS | {"bundle": Path("go1-parkour")}, "give --policy or --bundle, not both"),
        (THEIRS | {"modes": ("camera",)}, "a policy with an adapter has no modes: leave out"),
        (THEIRS, r"the policy mine\.onnx does not exist"),
    ],
)
def test_mistakes_are_named_before_anything_is_written(tmp_path, fields, message):
    with pytest.raises(RenetError, match=message):
        run_play(PlayCfg(**({"out": tmp_path / "film.mp4", "viewer": "none"} | fields)))
    assert not list(tmp_path.iterdir())


def test_a_folder_is_no_film(tmp_path):
    folder = tmp_path / "film.mp4"
    folder.mkdir()
    with pytest.raises(RenetError, match=r"film\.mp4 is a folder: give --out the name of a film"):
        run_play(PlayCfg(out=folder, viewer="none"))
    assert not list(folder.iterdir())


def test_a_second_on_a_tile_makes_a_film_of_a_checkpoint(tmp_path, monkeypatch):
    monkeypatch.setattr(painter, "PANEL", (96, 72))
    cfg = PlayCfg(CHECKPOINT, tmp_path / "film.mp4", "platform", fault=("gaussian:3@0.5s",))
    film = run_play(replace(cfg, seconds=1.0, viewer="none"))
    assert film.stat().st_size > 1000
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def test_robots_of_a_film_are_nominal():
    with open_evaluator(PlayCfg()) as (evaluator, _):
        events = evaluator.terrain_env_cfg("flat").events
    assert events.keys().isdisjoint({"motor_strength", "push"})


CONSTANT = """
<ir_version: 8, opset_import: ["" : 17]>
constant (float[N, 45] observation, float[N, 48, 64] depth) => (float[N, 12] action)
{
    starts = Constant <value_ints = [0]> ()
    ends = Constant <value_ints = [12]> ()
    axes = Constant <value_ints = [1]> ()
    part = Slice (observation, starts, ends, axes)
    action = Sub (part, part)
}
"""


@pytest.fixture
def films(monkeypatch):
    """The trace and the titles of each film, in place of drawing it."""
    drawn = []

    def keep(spec, trace, titles, fault):
        drawn.append((trace, titles))

    monkeypatch.setattr(video, "pictures", keep)
    monkeypatch.setattr(video, "film", lambda path, frames: path)
    return drawn


def test_somebody_elses_policy_walks_with_a_failing_and_a_healthy_camera(tmp_path, films):
    model = save_model(tmp_path / "constant.onnx", CONSTANT)
    cfg = PlayCfg(policy=model, adapter="onnx-depth", out=tmp_path / "a.mp4")
    run_play(replace(cfg, terrain="flat", fault=("blackout@0.5s",), seconds=1.0, viewer="none"))
    ((trace, titles),) = films
    assert titles == {0: "healthy", 1: "camera"}
    # Twins, side by side, whose policy does nothing with its images.
    healthy, failing = trace.film.poses[..., 2:].swapaxes(0, 1)
    np.testing.assert_allclose(healthy, failing, atol=1e-4)
    assert not trace.failing[:, 0].any()
    np.testing.assert_array_equal(np.flatnonzero(trace.failing[:, 1]), np.arange(25, 50))


def test_a_policy_without_a_camera_walks_alone(tmp_path, films):
    model = joint_model(tmp_path / "none.onnx", "y = Sub (x, x)")
    act = "return senses.joint_position + self.model.run(senses.joint_position)[0]"
    cfg = PlayCfg(policy=model, adapter=write_adapter(tmp_path / "mine.py", act))
    run_play(replace(cfg, terrain="flat", out=tmp_path / "a.mp4", seconds=1.0, viewer="none"))
    ((trace, titles),) = films
    assert titles == {0: "blind"}
    assert not trace.vision.any()


@pytest.mark.parametrize(
    ("interrupted", "error", "words"),
    [
        (True, KeyboardInterrupt, r"the film .*film\.mp4 is not written"),
        (False, RenetError, r"cannot write .*film\.mp4: .*\w"),
    ],
)
def test_a_film_whose_encoder_is_ended_says_why_there_is_none(
    tmp_path, monkeypatch, interrupted, error, words
):
    started = []

    class Recorded(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            started.append(self)

    def frames():
        yield np.zeros((64, 64, 3), np.uint8)
        started[-1].kill()
        started[-1].wait()
        if interrupted:
            raise KeyboardInterrupt
        # More than a pipe holds.
        for _ in range(100):
            yield np.zeros((64, 64, 3), np.uint8)

    monkeypatch.setattr(subprocess, "Popen", Recorded)
    with pytest.raises(error, match=words) as ended:
        video.film(tmp_path / "film.mp4", frames())
    assert "Error writing" not in str(ended.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["go1", "go2"])
def test_a_robot_without_visual_meshes_is_seen(name, monkeypatch):
    monkeypatch.setattr(painter, "PANEL", (96, 72))
    spec = mujoco.MjSpec.from_file(str(GO1.mjcf.with_name(f"{name}.xml")))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 1])
    start = spec.compile().qpos0[None]
    (view,) = painter.Painter(spec, start).draw(start)
    assert 0.02 < 1.0 - view.ground.mean() < 0.5


@pytest.mark.filterwarnings("error:MULTICCD is enabled")
def test_ground_of_heights_is_drawn_without_a_word(monkeypatch):
    monkeypatch.setattr(painter, "PANEL", (96, 72))
    spec = mujoco.MjSpec.from_file(str(GO1.mjcf))
    spec.add_hfield(name="rough", size=[5, 5, 0.1, 0.1], nrow=2, ncol=2, userdata=np.zeros(4))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="rough")
    painter.Painter(spec, spec.compile().qpos0[None])


def test_a_checkpoint_becomes_a_bundle_for_as_long_as_it_is_open():
    with bundle_folder(CHECKPOINT) as folder:
        assert folder is not None
        assert Bundle.load(folder).manifest.robot.name == "Unitree Go1"
        assert trained_env_cfg(Bundle.load(folder).manifest).robot == VISUAL_GO1
    assert not folder.exists()
    with bundle_folder(None) as folder:
        assert folder is None


def test_a_bundle_of_a_robot_unknown_here_is_refused():
    manifest = Bundle.load().manifest
    other = replace(manifest, provenance=replace(manifest.provenance, task="Renet-Spot-Flat"))
    with pytest.raises(RenetError, match="Renet-Spot-Flat is unknown here: start from the file"):
        trained_env_cfg(other)


def test_a_ground_that_is_mistyped_is_told_with_the_nearest_one(capsys):
    assert main(["play", "--terrain", "stiars"]) == 2
    assert capsys.readouterr().err == "renet: unknown --terrain 'stiars': did you mean stairs?\n"
