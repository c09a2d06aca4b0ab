import torch

from renet.training.storage import StepBuffer

from .conftest import ToyEnv, collect, make_runner


def test_records_are_copies() -> None:
    recorder, buffer, flag = StepBuffer(), torch.zeros(2), torch.zeros(2, dtype=torch.bool)
    for step in range(3):
        buffer.fill_(step)
        recorder.begin(observation=buffer)
        flag[:] = step == 1
        recorder.finish(time_out=flag)
    rows = recorder.stack()
    assert rows["observation"].tolist() == [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]
    assert rows["time_out"][:, 0].tolist() == [False, True, False]


def test_only_time_outs_are_bootstrapped() -> None:
    env = ToyEnv()
    alg = make_runner(env).alg
    rewards, rollout = collect(alg, env, 25), alg._rollout
    assert 0 < rollout.done.sum() < rollout.done.numel() / 2
    bonus = alg.np3o.cfg.gamma * rollout.value[..., 0] * rollout.done
    torch.testing.assert_close(rollout.rewards_and_costs[..., 0], rewards + bonus)
