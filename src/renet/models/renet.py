"""RENet: all networks in one module with one state dict."""

import torch
from rsl_rl.modules import EmpiricalNormalization
from torch import Tensor, nn

from renet.models.actor_critic import Actor, Critics
from renet.models.autoencoder import DepthAutoencoder
from renet.models.config import ModelCfg
from renet.models.estimators import OPEstimator, VPEstimator
from renet.models.expectation import ImageExpectation
from renet.models.him import HybridInternalModel


class RENet(nn.Module):
    """Both estimators with their HIM, the anomaly detector, the actor and the critics."""

    def __init__(self, cfg: ModelCfg, critic_size: int) -> None:
        super().__init__()
        self.cfg = cfg
        self.op = OPEstimator(cfg)
        self.vp = VPEstimator(cfg)
        self.op_him = HybridInternalModel() if cfg.him else None
        self.vp_him = HybridInternalModel() if cfg.him else None
        self.autoencoder = DepthAutoencoder(cfg.detector)
        self.expectation = ImageExpectation() if cfg.expect_image else None
        self.actor = Actor(cfg)
        self.critics = Critics(cfg, critic_size)
        self.critic_normalizer = EmpiricalNormalization(critic_size)

    def advance(
        self,
        history: Tensor,
        depth: Tensor,
        has_image: Tensor,
        latent_op: Tensor,
        latent_vp: Tensor,
    ) -> Tensor:
        """Compute both estimators' latents after a 10 Hz tick, [B, 128], OP's first.

        Arguments are those of `Estimator.forward`. `fuse` makes the actor's input of the latents.
        """
        depth = depth.to(history.dtype)
        next_op = self.op(history, depth, has_image, latent_op)
        next_vp = self.vp(history, depth, has_image, latent_vp)
        return torch.cat((next_op, next_vp), dim=-1)

    def supervised_parameters(self) -> list[nn.Parameter]:
        """List the parameters trained by supervision: all but those of actor and critics."""
        estimators = (self.op, self.vp, self.op_him, self.vp_him)
        modules = (*estimators, self.autoencoder, self.expectation)
        return [p for module in modules if module is not None for p in module.parameters()]
