"""The loop: runs, stops on time, resumes the same curve, refuses what does not fit."""

from dataclasses import asdict

import pytest
import torch
from mjlab.rl import RslRlVecEnvWrapper

from renet.errors import RenetError
from renet.models.config import ModelCfg
from renet.tasks import make_env
from renet.training import checkpoint as checkpoints
from renet.training.algorithm import critic_observation
from renet.training.config import (
    AdaptationCfg,
    LearningCfg,
    NP3OCfg,
    RenetRunnerCfg,
    SupervisionCfg,
    steps_per_env,
)
from renet.training.metrics import read_curves
from renet.training.runner import RenetRunner


def make_runner(env, log_dir, **fields):
    torch.manual_seed(0)
    cfg = RenetRunnerCfg(num_steps_per_env=10, save_interval=2, **fields)
    return RenetRunner(env, asdict(cfg), str(log_dir), "cpu")


def test_trains_and_writes_curves_and_checkpoints(toy_env, tmp_path):
    runner = make_runner(toy_env(), tmp_path)
    before = [p.clone() for p in runner.alg.model.parameters()]
    runner.learn(3)
    curves = read_curves(tmp_path)
    for name in ("Loss/surrogate", "Loss/vp_height_map", "Loss/anomaly", "Loss/cost_torque"):
        iterations, values = curves[name]
        assert iterations == [0, 1, 2]
        assert all(torch.isfinite(torch.tensor(values)))
    assert [p.name for p in checkpoints.checkpoints(tmp_path / "checkpoints")] == [
        "it_00000002",
        "it_00000003",
    ]
    after = list(runner.alg.model.parameters())
    moved = [not torch.equal(a, b) for a, b in zip(before, after, strict=True)]
    # VP steers first, so OP's own set is empty for the first 20 iterations.
    untouched = sum(p.numel() > 0 for p in [*runner.alg.model.op.parameters()])
    untouched += len([*runner.alg.model.op_him.parameters()])
    assert len(moved) - sum(moved) == untouched


def test_resume_restores_everything(toy_env, tmp_path):
    first = make_runner(toy_env(), tmp_path)
    first.env.levels += 3
    first.learn(2)
    second = make_runner(toy_env(), tmp_path)
    state = second.load(str(tmp_path))
    assert state["iteration"] == 2
    assert second.alg.np3o.learning_rate == first.alg.np3o.learning_rate
    assert second.alg.np3o.cost_weight == first.alg.np3o.cost_weight
    assert torch.equal(second.env.levels, first.env.levels)
    for a, b in zip(
        first.alg.model.state_dict().values(), second.alg.model.state_dict().values(), strict=True
    ):
        assert torch.equal(a, b)
    for a, b in (
        (first.alg.np3o, second.alg.np3o),
        (first.alg.supervision, second.alg.supervision),
    ):
        ours, theirs = (o.optimizer.state_dict()["state"] for o in (a, b))
        assert ours.keys() == theirs.keys()
        assert all(torch.equal(ours[i][k], theirs[i][k]) for i in ours for k in ours[i])
    second.learn(1)
    assert read_curves(tmp_path)["Loss/surrogate"][0] == [0, 1, 2]


def test_time_budget_stops_with_a_checkpoint(toy_env, tmp_path):
    runner = make_runner(toy_env(), tmp_path)
    runner.learn(10_000, time_budget_s=0.5)
    assert 0 < runner.alg.iteration < 10_000
    found = checkpoints.find(tmp_path)
    assert checkpoints.load(found).state["iteration"] == runner.alg.iteration


def test_refuses_a_checkpoint_of_another_architecture(toy_env, tmp_path):
    make_runner(toy_env(), tmp_path).learn(1)
    other = make_runner(toy_env(), tmp_path / "other", model=ModelCfg(encoder="mlp"))
    with pytest.raises(RenetError, match="encoder was attention, now mlp"):
        other.load(str(tmp_path))


def test_refuses_a_checkpoint_of_another_model_that_would_fit(toy_env, tmp_path):
    make_runner(toy_env(), tmp_path, model=ModelCfg(perception="vp")).learn(1)
    other = make_runner(toy_env(), tmp_path / "other")
    with pytest.raises(RenetError, match="perception was vp, now renet"):
        other.load(str(tmp_path))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RenetRunnerCfg(num_steps_per_env=24), "multiple of 5"),
        (lambda: RenetRunnerCfg(num_steps_per_env=0), "num-steps-per-env must be at least 1"),
        (lambda: RenetRunnerCfg(save_interval=0), "save-interval must be at least 1"),
        (lambda: RenetRunnerCfg(keep_checkpoints=-1), "keep-checkpoints must be at least 1"),
        (lambda: NP3OCfg(num_mini_batches=0), "num-mini-batches must be at least 1"),
        (lambda: SupervisionCfg(num_learning_epochs=0), "num-learning-epochs must be at least 1"),
        (lambda: AdaptationCfg(period=0), "period must be at least 1"),
        (lambda: ModelCfg(perception="vip"), "must be one of renet, vp, op, oracle"),  # type: ignore[arg-type]
        (lambda: ModelCfg(initial_std=0.0), "initial_std must be above 0"),
    ],
)
def test_impossible_settings_are_refused_before_anything_is_built(make, message):
    with pytest.raises(RenetError, match=message):
        make()


@pytest.mark.parametrize(
    ("robots", "steps"), [(1, 6400), (64, 100), (250, 30), (256, 25), (4096, 25)]
)
def test_few_robots_take_more_steps_each_unless_told_otherwise(robots, steps):
    assert steps_per_env(None, 6_400, robots, 0) == steps
    assert steps_per_env(10, 6_400, robots, 0) == 10


def test_batches_grow_with_the_steps_taken(toy_env, tmp_path):
    runner = make_runner(toy_env(), tmp_path)
    runner._recipe |= {"num_steps_per_env": None, "batch_size": "200@200,400@600"}
    steps = []
    for _ in range(4):
        runner.learn(1)
        steps.append(runner.alg.steps)
    # Eight robots: 25 steps, 25, then 300 / 8 = 37.5 rounded up to 40, then 395 / 8 to 50.
    assert steps == [200, 400, 720, 1120]


def test_a_checkpoint_tells_its_settings_rules_and_code(toy_env, tmp_path):
    runner = make_runner(toy_env(), tmp_path)
    runner.learn(5)
    found = checkpoints.load(checkpoints.find(tmp_path))
    assert found.state["config"]["algorithm"] == asdict(NP3OCfg()) | {"cost_budget": [0.0] * 3}
    assert found.state["steps"] == 5 * 10 * 8
    assert found.state["code"].startswith("0.")
    assert "task_cfg" in found.state
    # What is exported is the average, not the newest weights.
    assert found.exported is found.average
    newest = found.model["actor.log_std"]
    assert not torch.equal(
        found.exported["actor.mean.0.weight"], found.model["actor.mean.0.weight"]
    )
    assert newest.shape == found.exported["actor.log_std"].shape


def test_the_critics_see_who_drives(toy_env, tmp_path):
    alg = make_runner(toy_env(), tmp_path).alg
    obs = alg_obs = toy_env().get_observations()
    simple, difficult = (critic_observation(alg_obs, m) for m in (torch.ones(8), torch.zeros(8)))
    assert (simple[:, -1] == 1).all()
    assert (difficult[:, -1] == 0).all()
    alg.iteration = 20
    alg.act(obs)
    seen = alg._steps.newest["critic_observation"][:, -1]
    assert torch.equal(seen, 1 - obs["difficult"][:, 0])


def test_a_policy_that_diverged_is_not_saved(toy_env, tmp_path):
    runner = make_runner(toy_env(), tmp_path)
    runner.learn(2)
    update = runner.alg.update
    runner.alg.update = lambda: update() | {"surrogate": float("nan")}
    with pytest.raises(RenetError, match="diverged in iteration 3: surrogate is not finite"):
        runner.learn(4)
    assert checkpoints.find(tmp_path).name == "it_00000002"


def test_only_rank_0_goes_on_with_rank_0s_random_numbers(toy_env, tmp_path):
    make_runner(toy_env(), tmp_path).learn(1)
    drawn = []
    for rank in (0, 1):
        runner = make_runner(toy_env(), tmp_path)
        torch.manual_seed(100 + rank)
        runner.gpu_global_rank = rank
        runner.load(str(tmp_path))
        drawn.append(torch.rand(3))
    assert not torch.equal(*drawn)


def test_going_back_does_not_remove_what_was_just_written(toy_env, tmp_path):
    runner = make_runner(toy_env(), tmp_path, keep_checkpoints=3)
    runner.learn(6)
    runner.alg.iteration = 1
    runner.save()
    kept = [path.name for path in checkpoints.checkpoints(tmp_path / "checkpoints")]
    assert kept == ["it_00000001", "it_00000004", "it_00000006"]


@pytest.mark.parametrize("group", ["velocity", "proprioception", "privileged"])
def test_a_nan_in_what_the_environment_returns_stops_training(toy_env, tmp_path, group):
    env = toy_env()
    runner = make_runner(env, tmp_path)
    step = env.step

    def broken(action):
        obs, rewards, dones, extras = step(action)
        obs[group][1, 2] = torch.nan
        return obs, rewards, dones, extras

    env.step = broken
    with pytest.raises(RenetError, match=rf"task's {group} became NaN or infinite in iteration 1"):
        runner.learn(1)
    assert not list(tmp_path.glob("**/it_*"))


def test_an_iteration_reports_buffers_that_overflowed(tmp_path):
    """On MuJoCo Warp, the engine of GPUs, with its CPU backend."""
    env = RslRlVecEnvWrapper(make_env("Renet-Go1-Flat", 2, engine="warp"))
    runner = RenetRunner(env, asdict(LearningCfg(num_steps_per_env=5)), str(tmp_path), "cpu")
    runner.learn(1, init_at_random_ep_len=False)
    env.close()
    curves = read_curves(tmp_path)
    for name in ("contacts", "constraints"):
        assert curves[f"Loss/overflow_{name}"] == ([0], [0.0])
