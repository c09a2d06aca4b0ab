"""One iteration on MuJoCo Warp, the engine of GPUs, with its CPU backend."""

from __future__ import annotations

from dataclasses import asdict

from mjlab.rl import RslRlVecEnvWrapper

from renet.tasks import make_env
from renet.training.config import LearningCfg
from renet.training.metrics import read_curves
from renet.training.runner import RenetRunner


def test_an_iteration_reports_buffers_that_overflowed(tmp_path):
    env = RslRlVecEnvWrapper(make_env("Renet-Go1-Flat", 2, engine="warp"))
    runner = RenetRunner(env, asdict(LearningCfg(num_steps_per_env=5)), str(tmp_path), "cpu")
    runner.learn(1, init_at_random_ep_len=False)
    env.close()
    curves = read_curves(tmp_path)
    for name in ("contacts", "constraints"):
        assert curves[f"Loss/overflow_{name}"] == ([0], [0.0])
