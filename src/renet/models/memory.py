"""Memory of the estimators between ticks, batched over environments."""

from collections.abc import Callable

import torch
from torch import Tensor

from renet.interface import DEPTH_SHAPE, FRAMES, LATENT, PROPRIOCEPTION_SIZE, TICK_DT
from renet.models.config import ModelCfg


class EstimatorMemory:
    """Proprioception history, last two depth images and both GRU states of N robots.

    Both estimators always run, whichever the actor reads, so that a switch finds states that are
    up to date. After a reset the latents are zero until the next 10 Hz tick; the first
    proprioception fills the history, and the first image fills both frames. If an image is
    withheld, VP continues from its memory, and the next image fills both frames.
    """

    def __init__(self, cfg: ModelCfg, num_envs: int, device: str | torch.device) -> None:
        self.history = torch.zeros(num_envs, cfg.history, PROPRIOCEPTION_SIZE, device=device)
        self.frames = torch.zeros(num_envs, FRAMES, *DEPTH_SHAPE, dtype=torch.half, device=device)
        self.latent_op = torch.zeros(num_envs, LATENT, device=device)
        self.latent_vp = torch.zeros(num_envs, LATENT, device=device)
        self.blank = torch.ones(num_envs, dtype=torch.bool, device=device)
        """True where no proprioception has arrived since the reset."""
        self.fresh = torch.ones(num_envs, dtype=torch.bool, device=device)
        """True where no tick has happened since the reset."""
        self.has_image = torch.ones(num_envs, dtype=torch.bool, device=device)
        """True where the newest tick had an image."""
        self.image_age = torch.zeros(num_envs, device=device)
        """Seconds for which images have been withheld."""

    def reset(self, done: Tensor) -> None:
        """Forget everything about the robots whose episode ended; done is [N] bool."""
        keep = ~done.unsqueeze(-1)
        self.latent_op *= keep
        self.latent_vp *= keep
        self.image_age *= ~done
        self.blank |= done
        self.fresh |= done

    def push(self, proprioception: Tensor) -> None:
        """Append o_t [N, 45]; call this in every control step."""
        shifted = torch.cat((self.history[:, 1:], proprioception.unsqueeze(1)), dim=1)
        filled = proprioception.unsqueeze(1).expand_as(shifted)
        self.history = torch.where(self.blank[:, None, None], filled, shifted)
        self.blank.zero_()

    def see(self, depth: Tensor, has_image: Tensor | None = None) -> None:
        """Store the newest depth images; call this before `tick`.

        Args:
            depth: Images, [N, 48, 64] in [0, 1].
            has_image: False where the image is withheld, [N] bool; by default none is.
        """
        if has_image is None:
            has_image = torch.ones_like(self.fresh)
        depth = depth.to(self.frames.dtype)
        # Without an image at the previous tick, the new one takes its place, too.
        has_no_previous = (self.fresh | ~self.has_image)[:, None, None]
        previous = torch.where(has_no_previous, depth, self.frames[:, 0])
        pair = torch.stack((depth, previous), dim=1)
        self.frames = torch.where(has_image[:, None, None, None], pair, self.frames)
        self.has_image = has_image
        self.image_age = (self.image_age + TICK_DT) * ~has_image

    @torch.no_grad()
    def tick(self, advance: Callable[..., Tensor]) -> None:
        """Advance both estimators by one 10 Hz tick.

        Args:
            advance: Function that computes the next latents, `RENet.advance`.
        """
        latents = advance(self.history, self.frames, self.has_image, self.latent_op, self.latent_vp)
        self.latent_op = latents[:, :LATENT]
        self.latent_vp = latents[:, LATENT:]
        self.fresh.zero_()
