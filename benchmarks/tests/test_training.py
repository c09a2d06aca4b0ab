"""Where a training iteration goes, of a few robots on a plane."""

import json
from pathlib import Path

import pytest

import renet
import training
from training import Cfg


def test_no_part_of_an_iteration_takes_less_than_nothing(tmp_path, monkeypatch, two_threads):
    cfg = Cfg(task="Renet-Go1-Flat", num_envs=4, iterations=2)
    small = training.settings(cfg)
    small.agent.num_steps_per_env = 25
    monkeypatch.setattr(training, "settings", lambda cfg: small)
    results = training.profile(cfg, str(tmp_path))
    shares = results["profile"]
    assert min(shares.values()) > 0.0
    assert sum(shares.values()) == pytest.approx(1.0)
    assert set(results["learning"]) == {"N-P3O", "supervision"}
    assert max(results["learning"].values()) <= shares["update"]
    # Two iterations of 25 steps of 4 robots.
    seconds = cfg.iterations * results["seconds_per_iteration"]
    assert results["env_steps_per_s"] * seconds == pytest.approx(200)


def test_a_run_that_goes_on_has_its_own_settings_and_as_many_robots_as_asked():
    checkpoint = Path(renet.__file__).parent / "pretrained" / "checkpoint"
    (file,) = checkpoint.glob("*/state.json")
    stored = json.loads(file.read_text())["agent"]
    begun = training.settings(Cfg(num_envs=64))
    resumed = training.settings(Cfg(num_envs=64, resume=checkpoint))
    assert begun.agent.batch_size != stored["batch_size"] == resumed.agent.batch_size
    assert begun.env.scene.num_envs == resumed.env.scene.num_envs == 64
