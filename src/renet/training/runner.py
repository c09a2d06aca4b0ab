"""The training loop: rollouts, updates, checkpoints, and stopping on time."""

import os
import time
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from threading import Event
from typing import Any, cast

import numpy as np
import torch
import torch.distributed as dist
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

from renet.errors import RenetError
from renet.tasks import mdp
from renet.training import checkpoint as checkpoints
from renet.training import distributed
from renet.training.algorithm import RenetAlgorithm
from renet.training.checkpoint import Checkpoint
from renet.training.config import steps_per_env
from renet.training.precision import keep_freed_memory, multiply_by_onednn
from renet.training.provenance import described
from renet.version import code_version

CHECKPOINTS = "checkpoints"


class RenetRunner(OnPolicyRunner):
    """rsl_rl's runner with resumable checkpoints, growing batches and a time budget.

    rsl_rl's own loop has one batch size and no end but its number of iterations; its logger and its
    writers are used.
    """

    alg: RenetAlgorithm  # type: ignore[assignment]
    algorithm = "renet.training.algorithm:RenetAlgorithm"

    def __init__(
        self,
        env: VecEnv,
        train_cfg: dict[str, Any],
        log_dir: str | None = None,
        device: str = "cpu",
    ) -> None:
        if not device.startswith("cuda"):
            keep_freed_memory()
            multiply_by_onednn()
        self._agent = deepcopy(train_cfg)
        self.stop = Event()
        """Set by whoever wants training to stop, with a checkpoint, as soon as it can."""
        # Keys rsl_rl reads unconditionally; constructing the algorithm consumes the class name.
        train_cfg["algorithm"] |= {"class_name": self.algorithm, "rnd_cfg": None}
        super().__init__(env, train_cfg, log_dir, device)
        self.logger.git_status_repos = []
        self.folder = Path(log_dir) / CHECKPOINTS if log_dir else None

    def _configure_multi_gpu(self) -> None:
        """Join the process group: NCCL between GPUs, gloo on the CPU (and in tests)."""
        self.gpu_world_size = int(os.getenv("WORLD_SIZE", "1"))
        self.gpu_global_rank = int(os.getenv("RANK", "0"))
        self.is_distributed = self.gpu_world_size > 1
        self.cfg["multi_gpu"] = None
        if not self.is_distributed:
            return
        on_gpu = self.device.startswith("cuda")
        if on_gpu:
            torch.cuda.set_device(self.device)
        if not dist.is_initialized():
            dist.init_process_group("nccl" if on_gpu else "gloo")

    def learn(
        self,
        num_learning_iterations: int,
        init_at_random_ep_len: bool = True,
        time_budget_s: float = np.inf,
        report: Callable[[], object] = lambda: None,
    ) -> Path | None:
        """Train until so many more iterations are done, the time is up, or `stop` is set.

        Args:
            num_learning_iterations: at most. init_at_random_ep_len: spread the ends of episodes.
            time_budget_s: seconds in which to end, with a checkpoint, after one iteration at least.
            report: called after each iteration.

        Returns:
            The checkpoint that is left (on rank 0).
        """
        began = time.monotonic()
        if init_at_random_ep_len:
            self.env.episode_length_buf = torch.randint_like(
                self.env.episode_length_buf, high=int(self.env.max_episode_length)
            )
        obs = self.env.get_observations()
        self.alg.model.train()
        distributed.broadcast(self.alg.model)
        self.open_log()
        first, last, longest = self.alg.iteration, self.alg.iteration + num_learning_iterations, 0.0
        while self.alg.iteration < last:
            lap = time.monotonic()
            left = began + time_budget_s - lap
            if self._agree(self.stop.is_set() or (longest > 0.0 and left < 2.0 * longest)):
                break
            obs = self._iterate(obs, first, last)
            longest = max(longest, time.monotonic() - lap)
            report()
            if self.alg.iteration % self.cfg["save_interval"] == 0 and self.alg.iteration < last:
                self.save()
        newest = self.save()
        self.logger.stop_logging_writer()
        return newest

    def open_log(self) -> None:
        """Begin to write curves, if there is a folder for them."""
        self.cfg["logger"] = {  # Consumed.
            "class_name": "renet.training.metrics:CurvesWriter",
            "logger": self._agent["logger"],
            "project_name": self._agent["wandb_project"],
        }
        self.logger.init_logging_writer()

    def _iterate(self, obs: TensorDict, first: int, last: int) -> TensorDict:
        """One rollout and one update, logged; returns the observations after it."""
        start = time.monotonic()
        fixed, batch_size = self._agent["num_steps_per_env"], self._agent["batch_size"]
        steps = steps_per_env(fixed, batch_size, self.env.num_envs, self.alg.steps)
        self.cfg["num_steps_per_env"] = steps  # Which rsl_rl's logger reads.
        for _ in range(steps):
            if self.stop.is_set() and not self.is_distributed:
                return obs  # What the last update left is saved.
            obs, rewards, dones, extras = self.env.step(self.alg.act(obs))
            # A sum below zero counts as zero: dying early never pays (Extreme Parkour).
            rewards = rewards.clamp_min(0.0)
            costs = mdp.constraint_costs(cast(Any, self.env).unwrapped)
            self.alg.process_env_step(obs, rewards, dones, extras | {"costs": costs})
            self.logger.process_env_step(rewards, dones, extras, None)
        collected = time.monotonic()
        self.alg.compute_returns(obs)
        losses = self.alg.update()
        self._check_learning(losses, obs)
        self.current_learning_iteration = self.alg.iteration
        self.logger.log(
            it=self.alg.iteration - 1,
            start_it=first,
            total_it=last,
            collect_time=collected - start,
            learn_time=time.monotonic() - collected,
            loss_dict=losses,
            # The mean: the last value is that of a sawtooth.
            learning_rate=losses.pop("learning_rate", self.alg.np3o.learning_rate),
            action_std=self.alg.action_std,
            rnd_weight=None,
        )
        return obs

    def _check_learning(self, losses: dict[str, float], obs: Any) -> None:
        """Stop before a policy that is no longer one is saved; raises RenetError.

        What is not finite in a rollout shows in the losses: steps need no check of their own.
        """
        bad = [name for name, loss in losses.items() if not np.isfinite(loss)]
        if not self.alg.action_std.isfinite().all():
            bad.append("action noise")
        if self._agree(bool(bad)):
            if broken := self.alg.not_finite(obs):
                raise RenetError(
                    f"the task's {', '.join(broken)} became NaN or infinite in iteration "
                    f"{self.alg.iteration}. Nothing of it was saved: mend the task, go on with "
                    "--resume"
                )
            raise RenetError(
                f"learning diverged in iteration {self.alg.iteration}: "
                f"{', '.join(bad) or 'a loss'} is not finite. Nothing of it was saved: go on with "
                "--resume and a smaller --agent.algorithm.learning-rate"
            )

    def _agree(self, stop: bool) -> bool:
        """All ranks stop together: one that wants to decides for all."""
        return bool(distributed.mean(torch.tensor(float(stop), device=self.device)) > 0)

    # Checkpoints.

    def save(self, *_: Any) -> Path | None:  # type: ignore[override]
        """Write a checkpoint to the run's folder (rank 0 only); returns its folder."""
        if self.folder is None or self.gpu_global_rank != 0:
            return None
        algorithm = self.alg
        state = {
            "learning_rate": algorithm.np3o.learning_rate,
            "cost_weight": algorithm.np3o.cost_weight,
            "steps": algorithm.steps,
            "averaged": int(algorithm.average.n_averaged),
            "seconds": self.logger.tot_time,
            **self.provenance(),
        }
        environment = mdp.curriculum_state(cast(Any, self.env).unwrapped)
        environment["torch_rng"] = torch.get_rng_state()
        if self.device.startswith("cuda"):
            environment["cuda_rng"] = torch.cuda.get_rng_state(self.device)
        optimizer = checkpoints.optimizer_tensors(algorithm.optimizers)
        average = algorithm.average.module.state_dict()
        weights = algorithm.model.state_dict()
        checkpoint = Checkpoint(weights, optimizer, environment, state, average)
        keep = self.cfg["keep_checkpoints"]
        return checkpoints.save(checkpoint, self.folder, algorithm.iteration, keep)

    def provenance(self) -> dict[str, Any]:
        """Everything that shaped the policy: the task, both configurations, the code's version."""
        env = cast(Any, self.env).unwrapped
        settings = {"agent": self._agent, "env": getattr(env, "task_cfg", env.cfg)}
        return {"task": self._agent["task"], **described(settings), "code": code_version()}

    def load(self, path: str, **_: Any) -> dict:  # type: ignore[override]
        """Go on from a checkpoint folder; raises RenetError if it does not fit."""
        folder = checkpoints.find(Path(path))
        algorithm, state = self.alg, checkpoints.load_state(folder)
        checkpoints.check_model(algorithm.model.cfg, state, folder)
        checkpoint = checkpoints.load(folder, self.device, algorithm.model)
        checkpoints.load_model(algorithm.model, checkpoint.model, folder)
        try:
            self._go_on(checkpoint)
        except (KeyError, TypeError, ValueError) as error:
            raise RenetError(f"checkpoint {folder} is incomplete or damaged: {error}") from error
        return state

    def _go_on(self, checkpoint: Checkpoint) -> None:
        """Take over from a checkpoint whatever is not the model."""
        algorithm, state = self.alg, checkpoint.state
        checkpoints.load_optimizers(algorithm.optimizers, checkpoint.optimizer)
        before, now = state["agent"]["algorithm"], self._agent["algorithm"]
        for name in ("learning_rate", "cost_weight"):
            if before[name] == now[name]:  # Else it was asked for anew.
                setattr(algorithm.np3o, name, state[name])
        algorithm.iteration = self.current_learning_iteration = state["iteration"]
        algorithm.steps = state["steps"]
        algorithm.average.load(checkpoint.exported, state.get("averaged", algorithm.iteration))
        self.logger.tot_timesteps, self.logger.tot_time = state["steps"], state["seconds"]
        environment = checkpoint.environment
        torch_rng, cuda_rng = environment.pop("torch_rng"), environment.pop("cuda_rng", None)
        if self.gpu_global_rank == 0:  # Others draw numbers of their own.
            torch.set_rng_state(torch_rng.cpu())
            if cuda_rng is not None and self.device.startswith("cuda"):
                torch.cuda.set_rng_state(cuda_rng.cpu(), self.device)
        self.restore_curriculum(environment)

    def restore_curriculum(self, state: dict[str, torch.Tensor]) -> None:
        """Put the robots on the levels of a checkpoint's environment, if it kept any."""
        if state:
            mdp.load_curriculum_state(cast(Any, self.env).unwrapped, state, self.alg.steps)
            cast(Any, self.env).reset()
