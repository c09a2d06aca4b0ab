"""A policy's answers before and after it comes to be told twists."""

from pathlib import Path

import torch

import renet
from renet.interface import PROPRIOCEPTION_SIZE, TURN_GAIN
from renet.models.config import ModelCfg
from renet.models.renet import RENet
from renet.training import checkpoint as checkpoints
from renet.training.train import TrainCfg
from told_twists import COMMAND, Cfg, main, told_twists

SHIPPED = Path(renet.__file__).parent / "pretrained" / "checkpoint"


def network(weights: dict[str, torch.Tensor]) -> RENet:
    model = RENet(ModelCfg(detector="variance", predict_map_error=True), 232)
    model.load_state_dict(weights)
    return model.eval()


def told(observations: torch.Tensor, *command: float) -> torch.Tensor:
    """Observations, which begin with the proprioception, with another command."""
    changed = observations.clone()
    changed[..., COMMAND : COMMAND + 3] = torch.tensor(command)
    return changed


@torch.no_grad()
def test_a_policy_near_its_heading_answers_as_before():
    weights = checkpoints.load_checkpoint(checkpoints.find(SHIPPED)).model
    before = network(weights)
    after = network(told_twists(weights, exploration=0.1))
    torch.manual_seed(1)
    observation = 0.3 * torch.randn(8, PROPRIOCEPTION_SIZE)
    history = 0.3 * torch.randn(8, 10, PROPRIOCEPTION_SIZE)
    depth = torch.rand(8, 2, 48, 64)
    sees = torch.ones(8)
    latents = torch.zeros(8, 64), torch.zeros(8, 64)
    error = 0.01
    heading = 0.6, error, 1.0
    twist = 0.6, 0.0, TURN_GAIN * error
    old = before.advance(told(history, *heading), depth, sees, *latents)
    new = after.advance(told(history, *twist), depth, sees, *latents)
    torch.testing.assert_close(new, old, atol=1e-4, rtol=0.0)
    acts = before.actor(told(observation, *heading), old)
    torch.testing.assert_close(after.actor(told(observation, *twist), old), acts, atol=1e-4, rtol=0)
    seen = 0.3 * torch.randn(8, 232)
    old_values = before.critics(before.critic_normalizer(told(seen, *heading)))
    new_values = after.critics(after.critic_normalizer(told(seen, *twist)))
    torch.testing.assert_close(new_values, old_values, atol=1e-4, rtol=0.0)


def test_training_can_go_on_from_it(tmp_path):
    folder = main(Cfg(checkpoint=SHIPPED, out=tmp_path))
    state = checkpoints.load_state(folder)
    cfg = TrainCfg.resumed(state)
    assert cfg.agent.model.predict_far_map
    assert cfg.env.commands["goal"].told == "twist"
    model = RENet(cfg.agent.model, 232)
    checkpoint = checkpoints.load_checkpoint(folder, model=model)
    checkpoints.load_model(model, checkpoint.model, folder)
