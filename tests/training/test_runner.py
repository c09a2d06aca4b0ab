"""The loop: runs, stops on time, resumes the same curve, refuses what does not fit."""

import math
from dataclasses import asdict
from types import SimpleNamespace

import pytest
import torch
from mjlab.rl import RslRlVecEnvWrapper

from renet.curves import CURVES, read_curves
from renet.errors import RenetError
from renet.models.config import ModelCfg
from renet.tasks import make_env
from renet.tasks.motors import MotorsCfg
from renet.training import checkpoint as checkpoints
from renet.training.algorithm import critic_observation
from renet.training.config import (
    AdaptationCfg,
    NP3OCfg,
    RenetRunnerCfg,
    SupervisionCfg,
    WithholdingCfg,
)
from renet.training.runner import RenetRunner

from .conftest import ONE_EPOCH, ToyEnv, collect, make_runner


@pytest.fixture
def runner(tmp_path) -> RenetRunner:
    return make_runner(ToyEnv(), tmp_path)


def test_trains_and_writes_curves_and_checkpoints(runner, tmp_path):
    before = {name: p.clone() for name, p in runner.alg.model.named_parameters()}
    runner.learn(3)
    curves = read_curves(tmp_path / CURVES)
    for name in ("Loss/surrogate", "Loss/vp_height_map", "Loss/anomaly", "Loss/cost_torque"):
        assert [*curves[name]] == [0, 1, 2]
        assert torch.tensor([*curves[name].values()]).isfinite().all()
    names = [path.name for path in checkpoints.checkpoints(tmp_path / "checkpoints")]
    assert names == ["it_00000002", "it_00000003"]
    after = dict(runner.alg.model.named_parameters())
    unmoved = {name for name in before if torch.equal(before[name], after[name])}
    # VP steers first, so OP's own set is empty for the first 20 iterations.
    assert unmoved == {name for name in before if name.startswith(("op.", "op_him."))}


def test_resume_restores_everything(tmp_path):
    first = make_runner(ToyEnv(), tmp_path)
    first.env.goal.stage = 1
    first.learn(2)
    second = make_runner(ToyEnv(), tmp_path)
    state = second.load(str(tmp_path))
    assert state["iteration"] == 2
    drawn = torch.rand(3)
    torch.set_rng_state(
        checkpoints.load_checkpoint(checkpoints.find(tmp_path)).environment["torch_rng"]
    )
    assert torch.equal(drawn, torch.rand(3))
    assert second.alg.np3o.learning_rate == first.alg.np3o.learning_rate
    assert second.alg.np3o.cost_weight == first.alg.np3o.cost_weight
    assert second.alg.average.n_averaged == 2
    assert (second.env.goal.stage, second.env.common_step_counter) == (1, 20)
    for tensors in (
        lambda alg: alg.model.state_dict(),
        lambda alg: alg.average.module.state_dict(),
        lambda alg: checkpoints.optimizer_tensors(alg.optimizers),
    ):
        torch.testing.assert_close(tensors(first.alg), tensors(second.alg), atol=0, rtol=0)
    second.learn(1)
    assert [*read_curves(tmp_path / CURVES)["Loss/surrogate"]] == [0, 1, 2]


def test_resumed_run_learns_as_if_it_had_not_stopped(tmp_path):
    """From the same rollout, to the last bit: moments belong to the same weights as before."""
    first = make_runner(ToyEnv(), tmp_path)
    first.learn(2)
    second = make_runner(ToyEnv(), tmp_path)
    second.load(str(tmp_path))
    # A resumed run begins with new episodes.
    first.alg.memory.reset(torch.ones(8, dtype=torch.bool))
    for runner in (first, second):
        torch.manual_seed(5)
        collect(runner.alg, ToyEnv(seed=3))
        runner.alg.update()
    for tensors in (
        lambda alg: alg.model.state_dict(),
        lambda alg: alg.average.module.state_dict(),
        lambda alg: checkpoints.optimizer_tensors(alg.optimizers),
    ):
        torch.testing.assert_close(tensors(first.alg), tensors(second.alg), atol=0, rtol=0)


def test_new_rate_and_weight_are_obeyed(tmp_path):
    make_runner(ToyEnv(), tmp_path).learn(2)
    asked = NP3OCfg(learning_rate=1e-5, cost_weight=0.0)
    runner = make_runner(ToyEnv(), tmp_path, algorithm=asked)
    runner.load(str(tmp_path))
    assert runner.alg.np3o.learning_rate == pytest.approx(1e-5)
    assert runner.alg.np3o.cost_weight == 0.0


def test_time_budget_stops_with_a_checkpoint(runner, tmp_path):
    runner.learn(1)
    assert not runner.late, "its iterations are done"
    runner.learn(10_000, time_budget_s=0.5)
    assert runner.late
    assert runner.longest > 0.0
    assert 1 < runner.alg.iteration < 10_000
    assert (
        checkpoints.load_checkpoint(checkpoints.find(tmp_path)).state["iteration"]
        == runner.alg.iteration
    )


def test_refuses_a_checkpoint_of_another_model(tmp_path):
    make_runner(ToyEnv(), tmp_path).learn(1)
    # Weights of the second one would fit.
    for name, before, now in (("encoder", "attention", "mlp"), ("perception", "renet", "vp")):
        other = make_runner(ToyEnv(), tmp_path / "other", model=ModelCfg(**{name: now}))
        with pytest.raises(RenetError, match=f"{name} was {before}, now {now}"):
            other.load(str(tmp_path))


def test_refuses_weights_of_another_architecture(tmp_path):
    module = torch.nn.Linear(3, 2)
    for wrong, message in (
        ({"weight": torch.zeros(2, 3)}, "Missing key.*bias"),
        (module.state_dict() | {"other": torch.zeros(1)}, "Unexpected key.*other"),
        (module.state_dict() | {"bias": torch.zeros(3)}, "size mismatch for bias"),
    ):
        with pytest.raises(RenetError, match=f"is of another architecture: {message}"):
            checkpoints.load_model(module, wrong, tmp_path)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RenetRunnerCfg(num_steps_per_env=24), "multiple of 5"),
        (lambda: RenetRunnerCfg(num_steps_per_env=0), "num-steps-per-env must be at least 1"),
        (lambda: RenetRunnerCfg(save_interval=0), "save-interval must be at least 1"),
        (lambda: RenetRunnerCfg(keep_checkpoints=-1), "keep-checkpoints must be at least 1"),
        (lambda: RenetRunnerCfg(clip_actions=-1.0), "clip-actions must be above 0, got -1.0"),
        (lambda: RenetRunnerCfg(clip_actions=math.nan), "clip-actions must be above 0"),
        (lambda: NP3OCfg(num_mini_batches=0), "num-mini-batches must be at least 1"),
        (lambda: SupervisionCfg(num_learning_epochs=0), "num-learning-epochs must be at least 1"),
        (lambda: AdaptationCfg(period=0), "period must be at least 1"),
        (lambda: NP3OCfg(learning_rate=-1e-3), "learning_rate must be at least 0, got -0.001"),
        (lambda: NP3OCfg(critic_learning_rate=math.nan), "critic_learning_rate must be at least 0"),
        # Schedules at any time of a run.
        (lambda: NP3OCfg(max_std="0.5@1M,0@2M"), "max_std must be above 0"),
        (lambda: SupervisionCfg(learning_rate="0.001@1M,-1@2M"), "learning_rate must be at least"),
        (lambda: WithholdingCfg(easier_shortest="0.3@1M,0@2M"), "easier_sight must exceed 0"),
        (lambda: WithholdingCfg(easier_sight="4@1M,-1@2M,4@3M"), "easier_sight must exceed 0"),
        (lambda: ModelCfg(perception="vip"), "must be one of renet, vp, op, oracle"),  # type: ignore[arg-type]
        (lambda: ModelCfg(encoder="lstm"), "must be one of attention, mlp"),  # type: ignore[arg-type]
        (lambda: ModelCfg(initial_std=0.0), "initial_std must be above 0"),
        (lambda: ModelCfg(frames=3), "frames must be 1..2, got 3"),
        (lambda: ModelCfg(frames=0), "frames must be 1..2, got 0"),
        (lambda: ModelCfg(history=0), "history must be at least 1, got 0"),
    ],
)
def test_impossible_settings_are_refused(make, message):
    with pytest.raises(RenetError, match=message):
        make()


@pytest.mark.parametrize("motors", [{"target_delay": (0.0, 0.02)}, {"model": "go1"}])
def test_motors_that_an_environment_does_not_have_are_refused(motors):
    """As by mjlab's own `train`, whose environments know nothing of delays."""
    env = ToyEnv()
    env.cfg = SimpleNamespace(motors=MotorsCfg())
    make_runner(env)
    env.cfg.motors = MotorsCfg(**motors)
    with pytest.raises(RenetError, match="mjlab's own train has ideal motors"):
        make_runner(env)
    env.motors = object()
    make_runner(env)


def test_batches_grow_with_the_steps_taken(runner):
    runner._agent |= {"num_steps_per_env": None, "batch_size": "200@200,400@600"}
    steps = []
    for _ in range(4):
        runner.learn(1)
        steps.append(runner.alg.steps)
    # Eight robots: 25 steps, 25, then 300 / 8 = 37.5 rounded up to 40, then 395 / 8 to 50.
    assert steps == [200, 400, 720, 1120]


def test_checkpoint_states_settings_and_code(tmp_path):
    runner = make_runner(ToyEnv(), tmp_path, average_over=10)
    runner.learn(5)
    found = checkpoints.load_checkpoint(checkpoints.find(tmp_path))
    assert found.state["agent"]["algorithm"] == asdict(ONE_EPOCH) | {"cost_budget": [0.0] * 3}
    assert found.state["steps"] == 5 * 10 * 8
    assert found.state["code"].startswith("0.")
    assert "env" in found.state
    # What is exported is the average, not the newest weights.
    assert found.exported is found.average
    for name in ("actor.mean.0.weight", "actor.log_std"):
        assert found.exported[name].shape == found.model[name].shape
        assert not torch.equal(found.exported[name], found.model[name])


def test_a_step_never_pays_less_than_nothing(runner, monkeypatch):
    step, paid = runner.env.step, []

    def poor(actions):
        obs, rewards, dones, extras = step(actions)
        paid.append(rewards - 0.5)
        return obs, paid[-1], dones, extras

    monkeypatch.setattr(runner.env, "step", poor)
    monkeypatch.setattr(runner.alg.np3o.cfg, "gamma", 0.0)  # Nothing is bootstrapped.
    runner.learn(1)
    stored = runner.alg._rollout.rewards_and_costs
    assert min(map(torch.min, paid)) < 0.0
    assert torch.equal(stored[..., 0], torch.stack(paid).clamp_min(0.0))
    assert (stored[..., 1:] > 0.0).any(), "costs lie beside it"


def test_stop_saves_last_update(tmp_path):
    env = ToyEnv()
    runner, step = make_runner(env, tmp_path, save_interval=100), env.step

    def ask(actions):
        if env.common_step_counter == 25:  # In the third rollout of ten steps.
            runner.stop.set()
        return step(actions)

    env.step = ask
    newest = runner.learn(100)
    assert (newest.name, env.common_step_counter) == ("it_00000002", 26)
    weights = checkpoints.load_checkpoint(newest).model
    assert all(torch.equal(weights[n], v) for n, v in runner.alg.model.state_dict().items())


def test_the_critics_see_who_drives():
    alg, obs = make_runner(ToyEnv()).alg, ToyEnv().get_observations()
    for mask in (torch.ones(8), torch.zeros(8)):
        assert torch.equal(critic_observation(obs, mask)[:, -1], mask)
    alg.iteration = 20
    alg.act(obs)
    seen = alg._steps.newest["critic_observation"][:, -1]
    assert torch.equal(seen, 1 - obs["difficult"][:, 0])


def test_a_policy_that_diverged_is_not_saved(runner, tmp_path):
    runner.learn(2)
    update = runner.alg.update
    runner.alg.update = lambda: update() | {"surrogate": float("nan")}
    with pytest.raises(RenetError, match="diverged in iteration 3: surrogate is not finite"):
        runner.learn(4)
    assert checkpoints.find(tmp_path).name == "it_00000002"


def test_only_rank_0_restores_random_numbers(tmp_path):
    make_runner(ToyEnv(), tmp_path).learn(1)
    drawn = []
    for rank in (0, 1):
        runner = make_runner(ToyEnv(), tmp_path)
        torch.manual_seed(100 + rank)
        runner.gpu_global_rank = rank
        runner.load(str(tmp_path))
        drawn.append(torch.rand(3))
    assert not torch.equal(*drawn)


def test_newest_checkpoint_is_never_removed(tmp_path):
    runner = make_runner(ToyEnv(), tmp_path, keep_checkpoints=3)
    runner.learn(6)
    runner.alg.iteration = 1
    runner.save()
    kept = [path.name for path in checkpoints.checkpoints(tmp_path / "checkpoints")]
    assert kept == ["it_00000001", "it_00000004", "it_00000006"]


@pytest.mark.parametrize("group", ["velocity", "proprioception", "privileged"])
def test_nan_from_environment_stops_training(runner, tmp_path, group):
    step = runner.env.step

    def broken(action):
        obs, *others = step(action)
        obs[group][1, 2] = torch.nan
        return obs, *others

    runner.env.step = broken
    with pytest.raises(RenetError, match=rf"task's {group} became NaN or infinite in iteration 1"):
        runner.learn(1)
    assert not list(tmp_path.glob("**/it_*"))


def test_an_iteration_reports_buffers_that_overflowed(tmp_path):
    """On MuJoCo Warp, the engine of GPUs, with its CPU backend."""
    env = RslRlVecEnvWrapper(make_env("Renet-Go1-Flat", 2, engine="warp"))
    make_runner(env, tmp_path, num_steps_per_env=5).learn(1, init_at_random_ep_len=False)
    env.close()
    curves = read_curves(tmp_path / CURVES)
    for name in ("contacts", "constraints"):
        assert curves[f"Loss/overflow_{name}"] == {0: 0.0}
