"""rsl_rl's logger, which waits for the device once in an iteration, not in every control step."""

from typing import Any

import torch
from rsl_rl.utils.logger import Logger
from torch import Tensor


class EpisodeLog(Logger):
    """The same curves; returns and lengths of episodes stay on the device until they are asked for.

    `cur_reward_sum` and `cur_episode_length` [N] are those of the episodes under way.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._ended: list[Tensor] = []
        """Return and length of each robot's episode where it ended with a step, else NaN [2, N]."""

    def process_env_step(
        self,
        rewards: Tensor,
        dones: Tensor,
        extras: dict,
        intrinsic_rewards: Tensor | None = None,
    ) -> None:
        """See Logger.process_env_step."""
        del intrinsic_rewards  # RENet has none.
        if self.writer is None:
            return
        if extras.get("log"):
            self.ep_extras.append(extras["log"])
        self.cur_reward_sum += rewards
        self.cur_episode_length += 1
        done = dones.bool()
        episodes = torch.stack((self.cur_reward_sum, self.cur_episode_length))
        self._ended.append(episodes.where(done, torch.nan))
        self.cur_reward_sum *= ~done
        self.cur_episode_length *= ~done

    def log(self, *args: Any, **kwargs: Any) -> None:
        """See Logger.log."""
        if self._ended:
            returns, lengths = torch.stack(self._ended, dim=1).flatten(1).cpu()
            self._ended.clear()
            finished = ~lengths.isnan()
            self.rewbuffer.extend(returns[finished].tolist())
            self.lenbuffer.extend(lengths[finished].tolist())
        if self.ep_extras:
            self.ep_extras = [self._means()]
        super().log(*args, **kwargs)

    def _means(self) -> dict[str, Tensor]:
        """Of what the environment logged over the steps that logged it."""
        values: dict[str, list[Tensor]] = {}
        for step in self.ep_extras:
            for name, value in step.items():
                value = torch.as_tensor(value, dtype=torch.float32, device=self.device)
                values.setdefault(name, []).append(value.mean())
        means = torch.stack([torch.stack(rows).mean() for rows in values.values()]).cpu()
        return dict(zip(values, means, strict=True))
