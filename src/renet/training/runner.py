"""The training loop: rollouts, updates, checkpoints, and stopping on time."""

import contextlib
import io
import os
import time
from copy import deepcopy
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
import torch.distributed as dist
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from torch import Tensor

from renet.errors import RenetError
from renet.training import checkpoint as checkpoints
from renet.training import distributed
from renet.training.algorithm import RenetAlgorithm
from renet.training.checkpoint import Checkpoint, described
from renet.training.config import steps_per_env
from renet.training.precision import keep_freed_memory
from renet.version import code_version

CHECKPOINTS = "checkpoints"


class RenetRunner(OnPolicyRunner):
    """rsl_rl's runner with resumable checkpoints, a time budget and a progress bar."""

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
        self._recipe = deepcopy(train_cfg)
        # Keys rsl_rl reads unconditionally; constructing the algorithm consumes the class name.
        train_cfg["algorithm"] = {
            **train_cfg["algorithm"],
            "class_name": self.algorithm,
            "rnd_cfg": None,
        }
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
        time_budget_s: float | None = None,
    ) -> None:
        """Train until `num_learning_iterations` more are done or the time is up.

        Args:
            num_learning_iterations: upper bound of additional iterations.
            init_at_random_ep_len: spread episode ends over time from the start.
            time_budget_s: stop cleanly, with a checkpoint, before this many seconds have passed;
            one iteration is done in any case.
        """
        began = time.monotonic()
        if init_at_random_ep_len:
            self.env.episode_length_buf = torch.randint_like(
                self.env.episode_length_buf, high=int(self.env.max_episode_length)
            )
        obs = self.env.get_observations().to(self.device)
        self.alg.model.train()
        distributed.broadcast(self.alg.model)
        self.open_log()
        first = self.alg.iteration
        last = first + num_learning_iterations
        longest = told = 0.0
        with self._progress() as progress:
            task = progress.add_task("train", total=num_learning_iterations, status="")
            by_line = progress.disable and self.gpu_global_rank == 0
            while self.alg.iteration < last:
                lap = time.monotonic()
                obs = self._iterate(obs, first, last)
                longest = max(longest, time.monotonic() - lap)
                progress.update(task, advance=1, status=self._status())
                if by_line and time.monotonic() - told > 10.0:
                    told = time.monotonic()
                    print(f"{self.alg.iteration}/{last}  {self._status()}", flush=True)
                left = np.inf if time_budget_s is None else began + time_budget_s - time.monotonic()
                if self._agree(left < 2.0 * longest):
                    break
                iteration = self.alg.iteration
                if iteration % self.cfg["save_interval"] == 0 and iteration < last:
                    self.save()
        self.save()
        self.logger.stop_logging_writer()

    def open_log(self) -> None:
        """Begin to write curves, if there is a folder for them."""
        self.cfg["logger"] = {"class_name": "renet.training.metrics:MetricsWriter"}  # Consumed.
        with contextlib.redirect_stdout(io.StringIO()):
            self.logger.init_logging_writer()

    def _iterate(self, obs: Any, first: int, last: int) -> Any:
        """One rollout and one update, logged."""
        iteration = self.alg.iteration
        start = time.monotonic()
        asked, batch_size = self._recipe["num_steps_per_env"], self._recipe["batch_size"]
        steps = steps_per_env(asked, batch_size, self.env.num_envs, self.alg.steps)
        self.cfg["num_steps_per_env"] = steps  # Which rsl_rl's logger reads.
        for _ in range(steps):
            actions = self.alg.act(obs)
            obs, rewards, dones, extras = self.env.step(actions.to(self.env.device))
            obs, rewards = obs.to(self.device), rewards.to(self.device)
            dones = dones.to(self.device)
            self.alg.process_env_step(obs, rewards, dones, extras)
            self.logger.process_env_step(rewards, dones, extras, None)
        collected = time.monotonic()
        self.alg.compute_returns(obs)
        losses = self.alg.update()
        self._check_learning(losses, obs)
        self.current_learning_iteration = self.alg.iteration
        # rsl_rl's logger prints a page per iteration; the progress bar says it in a line.
        with contextlib.redirect_stdout(io.StringIO()):
            self.logger.log(
                it=iteration,
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
            broken = self.alg.not_finite(obs)
            if broken:
                raise RenetError(
                    f"the task's {', '.join(broken)} became NaN or infinite in iteration "
                    f"{self.alg.iteration}. Nothing of it was saved: mend the task, go on with "
                    "--resume"
                )
            raise RenetError(
                f"learning diverged in iteration {self.alg.iteration}: "
                f"{', '.join(bad) or 'a loss'} is not finite. Nothing of it was saved: go on with "
                "--resume and a smaller --algorithm.learning-rate"
            )

    def _agree(self, stop: bool) -> bool:
        """All ranks stop together: one that wants to decides for all."""
        return bool(distributed.mean(torch.tensor(float(stop), device=self.device)) > 0)

    def _progress(self) -> Progress:
        return Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[status]}"),
            # Without a terminal a redrawn bar is noise: `learn` prints a line now and then.
            disable=not os.isatty(1) or self.gpu_global_rank != 0,
            refresh_per_second=4,
        )

    def _status(self) -> str:
        """Steps, speed and the curves one watches."""
        latest = getattr(self.logger.writer, "latest", {})
        shown = {
            "steps/s": ("Perf/total_fps", ".0f"),
            "reward": ("Train/mean_reward", ".2f"),
            "length": ("Train/mean_episode_length", ".0f"),
            "rate": ("Loss/learning_rate", ".0e"),
        }
        parts = [f"{self.alg.steps / 1e6:.2f} M steps"]
        parts += [
            f"{name} {latest[tag]:{fmt}}" for name, (tag, fmt) in shown.items() if tag in latest
        ]
        return "  ".join(parts)

    # Checkpoints.

    def save(self, *_: Any) -> None:  # type: ignore[override]
        """Write a checkpoint to the run's folder (rank 0 only)."""
        if self.folder is None or self.gpu_global_rank != 0:
            return
        algorithm = self.alg
        state = {
            "learning_rate": algorithm.np3o.learning_rate,
            "cost_weight": algorithm.np3o.cost_weight,
            "steps": algorithm.steps,
            "averaged": int(algorithm.average.n_averaged),
            "seconds": self.logger.tot_time,
            "task": self.cfg.get("task", ""),
            **self.provenance(),
        }
        # The environment of mjlab's own command has none.
        curriculum = getattr(cast(Any, self.env).unwrapped, "curriculum_state", dict)()
        environment = curriculum | {"torch_rng": torch.get_rng_state()}
        if self.device.startswith("cuda"):
            environment["cuda_rng"] = torch.cuda.get_rng_state(self.device)
        checkpoint = Checkpoint(
            algorithm.model.state_dict(),
            checkpoints.optimizer_tensors(algorithm.optimizers),
            environment,
            state,
            algorithm.average.module.state_dict(),
        )
        keep = self.cfg["keep_checkpoints"]
        checkpoints.save(checkpoint, self.folder, algorithm.iteration, keep)

    def provenance(self) -> dict[str, Any]:
        """Everything that shaped the policy: settings, the task's rules, the code's version."""
        return {
            "config": self._recipe,
            "task_cfg": described(cast(Any, self.env).unwrapped.cfg),
            "code": code_version(),
        }

    def load(self, path: str, **_: Any) -> dict:  # type: ignore[override]
        """Go on from a checkpoint folder; raises RenetError if it does not fit."""
        found = checkpoints.find(Path(path))
        algorithm, state = self.alg, checkpoints.load_state(found)
        checkpoints.check_config(self.cfg["model"], state["config"]["model"], found)
        checkpoint = checkpoints.load(found, self.device, algorithm.model)
        checkpoints.load_model(algorithm.model, checkpoint.model, found)
        checkpoints.load_optimizers(algorithm.optimizers, checkpoint.optimizer)
        before, now = state["config"]["algorithm"], self._recipe["algorithm"]
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
        self._restore_curriculum(environment)
        return state

    def _restore_curriculum(self, tensors: dict[str, Tensor]) -> None:
        if tensors:
            cast(Any, self.env).unwrapped.load_curriculum_state(tensors)
            cast(Any, self.env).reset()
