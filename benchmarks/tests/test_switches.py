from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from baselines.switches import (
    BLIND,
    INPUTS,
    Experience,
    Gate,
    ReturnSwitch,
    SwitchEvaluator,
    SwitchSelector,
    collect,
    fit,
)
from renet.errors import RenetError
from renet.evaluation.rollout import Trial
from renet.faults import Injection
from renet.selector import SelectorInput

NOTHING = SelectorInput(np.zeros(4))


def experience(steps: int = 60, robots: int = 32) -> Experience:
    """A camera fails where the anomaly score is high; vision then pays 0, else 1, blindness 0.6."""
    torch.manual_seed(0)
    inputs = 0.1 * torch.randn(steps, robots, INPUTS)
    failing = (torch.arange(robots) % 2 == 0).expand(steps, robots).clone()
    inputs[..., -1] = 2.0 * failing.float() - 1.0
    vision = (torch.arange(robots) // 2 % 2 == 0).expand(steps, robots).clone()
    reward = torch.where(vision, (~failing).float(), torch.full((steps, robots), 0.6))
    done = torch.zeros(steps, robots, dtype=torch.bool)
    return Experience(inputs, reward, done, vision, failing)


def test_returns_are_a_discounted_mean_within_the_episode() -> None:
    targets: list[torch.Tensor] = []

    class Listener(ReturnSwitch):
        def loss(self, seen: Experience, returns: torch.Tensor) -> torch.Tensor:
            targets.append(returns)
            return super().loss(seen, returns)

    torch.manual_seed(1)
    reward, done = torch.rand(12, 5), torch.rand(12, 5) < 0.2
    seen = replace(experience(12, 5), reward=reward, done=done)
    fit(Listener((4,)), seen, gamma=0.9, horizon=4, epochs=1)
    assert targets[0].shape == (8, 5)
    for t in range(8):
        for n in range(5):
            total, weight = 0.0, 0.1
            for ahead in range(t, 12):
                total += weight * float(reward[ahead, n])
                weight *= 0.9
                if done[ahead, n]:
                    break
            assert float(targets[0][t, n]) == pytest.approx(total, rel=1e-5)


@pytest.mark.parametrize("kind", [ReturnSwitch, Gate])
def test_learns_to_prefer_blindness_where_vision_pays_less(kind) -> None:
    seen = experience()
    torch.manual_seed(0)
    switch = kind((16,))
    losses = fit(switch, seen, gamma=0.8, horizon=15, epochs=150, rate=1e-2)
    assert losses[-1] < 0.3 * losses[0]
    preference = switch.preference(seen.inputs).detach()
    assert (preference[seen.failing] < 0).float().mean() > 0.97
    assert (preference[~seen.failing] > 0).float().mean() > 0.97


def test_the_blind_estimator_does_not_see() -> None:
    switch, inputs = ReturnSwitch((8,)), torch.randn(3, INPUTS)
    other = inputs.clone()
    other[:, BLIND:] += 1.0
    blind = switch.blind(inputs[:, :BLIND]), switch.blind(other[:, :BLIND])
    torch.testing.assert_close(*blind)
    assert (switch.preference(inputs) != switch.preference(other)).all()


def test_refuses_experience_it_cannot_learn_from() -> None:
    seen = experience()
    with pytest.raises(RenetError, match="too few"):
        fit(Gate((4,)), seen, horizon=100)
    with pytest.raises(RenetError, match="both VP and OP"):
        fit(ReturnSwitch((4,)), replace(seen, vision=torch.ones_like(seen.vision)), horizon=5)
    with pytest.raises(RenetError, match="both healthy and failing"):
        fit(Gate((4,)), replace(seen, failing=torch.zeros_like(seen.failing)), horizon=5)


def selector(preference: torch.Tensor, **settings) -> SwitchSelector:
    policy = SimpleNamespace(num_robots=len(preference), inputs=preference)
    switch = SimpleNamespace(preference=lambda inputs: inputs)
    return SwitchSelector(switch, policy, **settings)  # type: ignore[arg-type]


def test_a_flickering_preference_is_smoothed_and_a_lasting_one_is_obeyed() -> None:
    preference = torch.ones(4)
    switch = selector(preference, smoothing=0.05)
    for update in range(400):
        preference[0] = 1.0 if update % 4 != 3 else -1.0  # Low a quarter of the time.
        preference[1] = 1.0 if update < 200 else -1.0
        trusted = switch.update(NOTHING, 0.0)
        assert trusted[0]
        assert trusted[1] or update >= 200
    assert trusted.tolist() == [True, False, True, True]
    assert switch.probability[1] < 0.5 < switch.probability[0]


def test_reset_trusts_vision_again() -> None:
    preference = torch.full((2,), -1.0)
    switch = selector(preference, smoothing=1.0)
    assert not switch.update(NOTHING, 0.0).any()
    preference[:] = 1.0
    switch.reset(np.array([True, False]))
    preference[:] = torch.tensor([0.0, -1.0])
    assert switch.update(NOTHING, 0.0).tolist() == [True, False]


def test_runs_in_the_closed_loop_of_the_studies(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluator = SwitchEvaluator(conditions="nominal")
    fault = (Injection.of("blackout", 5, onset=5),)
    trials = [Trial(mode, fault if bad else ()) for mode in ("camera", "blind") for bad in (0, 1)]
    env = evaluator.make_env("flat", range(4), 0.6, 1)
    seen = collect(evaluator, env, trials, 15, 1)
    assert seen.inputs.shape == (15, 4, INPUTS)
    assert seen.vision[:, :2].all()
    assert not seen.vision[:, 2:].any()
    assert seen.failing[5:, [1, 3]].all()
    assert not seen.failing[:, [0, 2]].any()
    plain = evaluator.provenance(1)
    evaluator.switch = Gate()
    before = evaluator.provenance(1)
    fit(evaluator.switch, seen, horizon=2, epochs=60)
    after = evaluator.provenance(1)
    assert (plain.bundle, after.bundle) == (evaluator.bundle.name, f"{plain.bundle} with Gate")
    assert len({plain.bundle_hash, before.bundle_hash, after.bundle_hash}) == 3
    obeying = [Trial("memory", trial.schedule) for trial in trials]
    trace = evaluator.rollout(env, obeying, 1).run(60)
    assert not trace.vision[-1, [1, 3]].any()
    assert trace.vision[-1, [0, 2]].all()
    step = env.step
    monkeypatch.setattr(env, "step", lambda action: replace(step(action), ended=np.ones(4, bool)))
    assert not collect(evaluator, env, trials, 2, 1).done.any(), "who crosses a tile goes on"
