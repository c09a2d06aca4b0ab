import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from renet.bundle import (
    DEFAULT,
    Bundle,
    pretrained,
    read_manifest,
    write_bundle,
    write_manifest,
)
from renet.bundle.manifest import SelectorSpec
from renet.errors import RenetError
from renet.evaluation import calibrate, calibrate_memory
from renet.evaluation.calibrate import (
    CalibrateCfg,
    _calibrate_monitors,
    _leave_out_blunt,
    run_calibrate,
)
from renet.evaluation.env import terrain_env_cfg
from renet.evaluation.evaluator import Evaluator
from renet.evaluation.rollout import Trial
from renet.faults import Injection
from renet.selector.monitors import MONITORS
from renet.tasks import VISUAL_GO1
from renet.tasks.parkour_env_cfg import randomize


@pytest.fixture(scope="module")
def bundle(tmp_path_factory, models, manifest) -> Path:
    """Untrained networks: real files, real models, no skill.

    Their reconstruction is about 0.5 everywhere: 0.25 from black and white, less from ground.
    """
    manifest = replace(manifest, selector=SelectorSpec(beta=0.18))
    return write_bundle(tmp_path_factory.mktemp("evaluator") / "bundle", models, manifest)


def test_a_bundle_drives_simulated_robots_and_leaves_vision_when_it_is_spoilt(bundle):
    evaluator = Evaluator(bundle)
    noise = (Injection("salt_and_pepper", 1.0, onset=10),)
    rows = [Trial("switch"), Trial("switch", noise), Trial("camera", noise), Trial("blind", noise)]
    world = evaluator.make_env("Renet-Go1-Flat", [0, 1, 2, 3, 3], 0.6, 1)
    trace = evaluator.rollout(world, [*rows, Trial("blind")], 1).run(30, film=[1])
    assert np.isfinite(trace.forward_velocity).all()
    assert trace.vision[:, [0, 2]].all()
    # The first spoilt image comes with a clean one before it; the next tick has two.
    assert not trace.vision[20:, 1].any()
    assert trace.film.images[0].std() > 5
    assert not trace.fallen.any()
    # Studies need not run OP again for each fault: it does the same.
    assert (trace.anomaly[20:, 3] > 1.2 * trace.anomaly[20:, 4]).all()
    np.testing.assert_allclose(trace.travelled[:, 3], trace.travelled[:, 4], atol=1e-5)
    assert evaluator.provenance(3).bundle_hash == evaluator.bundle.sha256


def test_the_shipped_selector_walks_on_vision_through_sparse_grass_alone():
    evaluator, severities = Evaluator(conditions="nominal"), (1, 2, 4, 5)
    grass = {s: (Injection.of("tall_grass", s, onset=20),) for s in severities}
    trials = [Trial("memory", grass[s], robot) for s in severities for robot in range(5)]
    env = evaluator.make_env("flat", [trial.robot for trial in trials], 0.6, 1)
    sees = evaluator.rollout(env, trials, 1).run(120).sees.all(axis=(0, 1)).reshape(4, 5)
    assert sees[:2].sum() >= 9
    assert not sees[2:].any()


def test_calibration_is_written_into_the_bundle_without_and_with_sparse_grass(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(calibrate_memory, "BLACKOUT_RANGE", (0.1, 0.2))
    monkeypatch.setattr(calibrate_memory, "MEASURED_TIME", 0.6)
    # Only robots that walk count: the shipped policy's do.
    bundle = Path(shutil.copytree(pretrained(DEFAULT), tmp_path / "bundle"))
    short = CalibrateCfg(bundle, robots=2, seconds=2.0, terrains=("flat",), conditions="nominal")
    beta = run_calibrate(replace(short, sparse_grass=False))
    selector = read_manifest(bundle).selector
    assert selector.beta == pytest.approx(beta)
    assert "maximum of 40 scores" in selector.calibration
    assert set(selector.thresholds) >= {"reconstruction", "uniformity", "frame_age", "duplicate"}
    assert selector.thresholds["reconstruction"] > beta
    assert (selector.gamma, selector.false_alarms_per_hour) == (0.1, 0.5)
    assert selector.healthy_hours == pytest.approx(4 / 3600)
    assert Evaluator(bundle).beta == selector.thresholds["reconstruction"]
    assert Evaluator(bundle).paper_beta == pytest.approx(beta)
    assert Bundle.load(bundle).sha256 != Bundle.load(pretrained(DEFAULT)).sha256
    assert 0.0 < selector.longest_memory <= 0.6
    # Where a variance is predicted, sparse grass passes.
    monkeypatch.setattr(calibrate, "memory_limits", lambda *arguments: ({}, 0.5))
    bare = selector.thresholds["invalid_fraction"]
    beta, selector = run_calibrate(short), read_manifest(bundle).selector
    assert selector.thresholds["invalid_fraction"] > 1.05 * bare, "blades hide what is behind them"
    assert 1.0 < selector.thresholds["variance"] < 4.0
    assert beta < 0.02, "the paper's rule knows healthy images alone"
    names = Evaluator(bundle).make_selector("memory", 1).thresholds
    assert {"variance", "reconstruction"} & {*names} == {"variance"}


def test_thresholds_below_zero_are_lifted_for_sparse_grass_too():
    scores = np.linspace(0.01, 0.02, 300)
    healthy = {name: [scores] for name in MONITORS} | {"uniformity": [scores - 0.22]}
    grassy = {"uniformity": [scores - 0.14]}
    bundle = Bundle.load()
    cfg = CalibrateCfg(bundle.path)
    thresholds = _calibrate_monitors(cfg, bundle, healthy, grassy).thresholds
    assert thresholds["uniformity"] == pytest.approx(-0.12, abs=1e-3)


@pytest.mark.parametrize(("walks", "accepted"), [(20, 20), (50, 49), (51, 50), (75, 74), (100, 98)])
def test_49_of_50_walks_through_sparse_grass_are_accepted(walks, accepted):
    scores = np.linspace(0.01, 0.02, 300)
    healthy = {name: [scores] for name in MONITORS}
    peaks = np.linspace(0.021, 0.022, walks)
    grassy = {"variance": [np.full(20, peak) for peak in peaks]}
    bundle = Bundle.load()
    thresholds = _calibrate_monitors(CalibrateCfg(bundle.path), bundle, healthy, grassy).thresholds
    assert (peaks <= thresholds["variance"]).sum() == accepted


def test_grass_that_surprises_now_and_then_but_not_twice_in_a_row_lifts_no_threshold():
    scores = np.linspace(0.01, 0.02, 300)
    healthy = {name: [scores] for name in MONITORS}
    peaks = np.where(np.arange(300) % 10 == 0, 0.03, 0.01)
    grassy = {"surprise": [peaks], "variance": [peaks]}
    bundle = Bundle.load()
    cfg = CalibrateCfg(bundle.path)
    thresholds = _calibrate_monitors(cfg, bundle, healthy, grassy).thresholds
    assert thresholds["surprise"] < 0.025
    assert thresholds["variance"] == pytest.approx(0.03)


def test_monitor_that_cannot_tell_healthy_images_is_left_out(capsys):
    # Stillness objects at no more than 0.9, surprise at 8. `frame_age` would judge by its fallback.
    thresholds = {"stillness": 0.95, "surprise": 1.5, "frame_age": 1.2}
    _leave_out_blunt(thresholds)
    assert thresholds == {"surprise": 1.5, "frame_age": 1.2}
    assert "stillness is left out: with a threshold of 0.95" in capsys.readouterr().out


@pytest.mark.parametrize(("lift", "expected"), [(1.5, 1.5), (0.5, 1.0)])
def test_monitors_that_withhold_single_images_are_calibrated_with_them(
    tmp_path, monkeypatch, lift, expected
):
    """Robots that withhold by the first thresholds have other scores; the higher ones count."""
    bundle = Path(shutil.copytree(pretrained("go1-driven"), tmp_path / "bundle"))
    scores = np.random.default_rng(0).exponential(0.02, 2000)
    walks = []

    def runs(cfg, evaluator, grass, mode="camera"):
        walks.append((mode, grass, evaluator.thresholds.get("surprise")))
        factor = lift if mode == "memory" else 1.0
        return {name: [factor * scores] for name in MONITORS}

    monkeypatch.setattr(calibrate, "_healthy_runs", runs)
    monkeypatch.setattr(calibrate, "memory_limits", lambda *arguments: ({"map_error": 0.4}, 7.0))
    shipped = read_manifest(bundle).selector.thresholds["surprise"]
    run_calibrate(CalibrateCfg(bundle, sparse_grass=False))
    selector = read_manifest(bundle).selector
    first = walks[1][2]
    assert walks == [("camera", False, shipped), ("memory", False, first)]
    assert first != shipped
    assert selector.thresholds["surprise"] == pytest.approx(expected * first)
    # A monitor that objects to single images is calibrated on robots that see all of them.
    assert selector.thresholds["variance"] == pytest.approx(2.0 * first, rel=0.3)
    assert (selector.thresholds["map_error"], selector.longest_memory) == (0.4, 7.0)


def test_robots_whose_memory_is_measured_obey_the_new_thresholds(tmp_path, monkeypatch):
    """A bundle that has just been exported has limits of memory as one that is calibrated again."""
    bundle = Path(shutil.copytree(pretrained(DEFAULT), tmp_path / "bundle"))
    exported = SelectorSpec(beta=0.01, longest_memory=6.0)
    write_manifest(bundle, replace(read_manifest(bundle), selector=exported))
    scores = np.random.default_rng(0).exponential(0.02, 2000)
    obeyed = []

    def limits(evaluator, *arguments):
        obeyed.append(evaluator.make_selector("memory", 1).thresholds)
        return {"map_error": 0.4}, 7.0

    names = ("frame_age", "reconstruction", "disagreement", "map_error")
    monkeypatch.setattr(
        calibrate, "_healthy_runs", lambda *arguments, **options: {n: [scores] for n in names}
    )
    monkeypatch.setattr(calibrate, "memory_limits", limits)
    run_calibrate(CalibrateCfg(bundle, sparse_grass=False))
    written = read_manifest(bundle).selector.thresholds
    assert written.keys() == {*names}
    (thresholds,) = obeyed
    for name in ("frame_age", "reconstruction", "disagreement"):
        assert thresholds[name] == written[name]


def test_calibration_walks_in_the_conditions_that_are_asked_for_and_by_default_in_trainings(
    tmp_path, monkeypatch
):
    bundle = Path(shutil.copytree(pretrained(DEFAULT), tmp_path / "bundle"))
    tasks = []

    def begin(evaluator, task, *arguments):
        tasks.append(task)
        raise RenetError("begun")

    monkeypatch.setattr(Evaluator, "make_env", begin)
    cfg = CalibrateCfg(bundle, terrains=("parkour",))
    for asked in (replace(cfg, conditions="nominal"), replace(cfg, conditions="training"), cfg):
        with pytest.raises(RenetError, match="begun"):
            run_calibrate(asked)
    drawn = [{"push", "motor_strength"} & {*task.events} for task in tasks]
    assert drawn == [set(), {"push", "motor_strength"}, {"push", "motor_strength"}]


WRONG = {"robots": 0, "terrains": ("flat", "park"), "speed": 0.0, "seconds": np.inf}
WRONG |= {"false_alarm": 2.0, "false_alarms_per_hour": 0.0}


@pytest.mark.parametrize(("name", "value"), [*WRONG.items(), ("terrains", ())])
def test_calibration_refuses_mistakes_before_anybody_walks(bundle, name, value, monkeypatch):
    monkeypatch.setattr(Evaluator, "rollout", lambda *args, **kwargs: pytest.fail("walked"))
    with pytest.raises(RenetError):
        run_calibrate(CalibrateCfg(bundle, **{name: value}))


def test_twins_are_alike_in_batches_of_any_size_and_every_run_is_the_same(bundle):
    evaluator = Evaluator(bundle)

    def walk(*robots):
        cfg = terrain_env_cfg("flat", VISUAL_GO1)
        randomize(cfg, joint_offset=0.05, action_delay=0.02, no_load_speed=(0.5, 1.0))
        env = evaluator.make_env(cfg, robots, 0.6, 1)
        zeros = env.env.scene["robot"].data.encoder_bias
        motors = env.env.motors
        assert all((zeros[row] == zeros[robots.index(n)]).all() for row, n in enumerate(robots))
        assert len(zeros.unique(dim=0)) == 2
        seen = env.reset().depth.copy()
        first = [robots.index(number) for number in robots]
        for values in (motors.lag, motors.no_load_speed):
            assert torch.equal(values, values[first])
        rows = [Trial("camera", robot=number) for number in robots]
        traces = [evaluator.rollout(env, rows, 1).run(40) for _ in range(2)]
        once, again = (np.stack([t.forward_velocity, t.travelled]) for t in traces)
        np.testing.assert_array_equal(once, again)
        return once, seen

    (few, near), (many, far) = walk(0, 1, 0), walk(1, 1, 0, 1, 0, 0, 1)
    np.testing.assert_allclose(near[[0, 2, 1]], far[[2, 5, 6]], atol=1e-3)  # Of float16.
    np.testing.assert_allclose(few[:, :, [0, 2, 1]], many[:, :, [2, 5, 6]], atol=1e-4)
    assert np.abs(few[:, :, 0] - few[:, :, 1]).max() > 0.01
