"""Training loop: rollouts, updates, checkpoints, and a limit on time."""

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
from mjlab.utils.wandb import add_wandb_tags
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
from renet.training.provenance import to_json
from renet.version import code_version

CHECKPOINTS = "checkpoints"
"""Name of the folder of checkpoints in a run's folder."""


class RenetRunner(OnPolicyRunner):
    """rsl_rl's runner with resumable checkpoints, growing batches and a time budget.

    The loop replaces rsl_rl's, which has one batch size and ends only after a number of iterations.
    Logger and writers are rsl_rl's.
    """

    alg: RenetAlgorithm  # type: ignore[assignment]
    algorithm = "renet.training.algorithm:RenetAlgorithm"
    """Module and class of the algorithm, which a subclass may replace."""

    def __init__(
        self,
        env: VecEnv,
        train_cfg: dict[str, Any],
        log_dir: str | None = None,
        device: str = "cpu",
    ) -> None:
        task = cast(Any, env).unwrapped
        motors = getattr(task.cfg, "motors", None)
        # mjlab's own environment would ignore other motors.
        if motors is not None and not motors.plain_servos and not hasattr(task, "motors"):
            raise RenetError(
                "mjlab's own train has ideal motors, and this task has others (--env.motors): "
                "train it by `renet train`"
            )
        if not device.startswith("cuda"):
            keep_freed_memory()
            multiply_by_onednn()
        self._agent = deepcopy(train_cfg)
        self.stop = Event()
        """Request to stop as soon as possible, with a checkpoint; any thread may set it."""
        self.longest = 0.0
        """Duration of the longest iteration of the last `learn`, s."""
        self.late = False
        """True if the last `learn` ended because no further iteration fitted into its time."""
        # rsl_rl needs these keys, and removes the class name from the dictionary.
        train_cfg["algorithm"] |= {"class_name": self.algorithm, "rnd_cfg": None}
        super().__init__(env, train_cfg, log_dir, device)
        # rsl_rl would write the uncommitted changes of the working tree to the run's folder.
        self.logger.git_status_repos = []
        self.folder = Path(log_dir) / CHECKPOINTS if log_dir else None

    @property
    def _mjlab_env(self) -> Any:
        """mjlab's environment inside rsl_rl's wrapper."""
        return cast(Any, self.env).unwrapped

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
        """Train until the iterations are done, the time is up, or `stop` is set.

        Args:
            num_learning_iterations: Largest number of iterations.
            init_at_random_ep_len: Start episodes at random ages, so that their ends are spread.
            time_budget_s: Time in which to end with a checkpoint, s. At least one iteration is
                done.
            report: Function to call after each iteration.

        Returns:
            Folder of the last checkpoint, or None on ranks above 0.
        """
        start = time.monotonic()
        if init_at_random_ep_len:
            self.env.episode_length_buf = torch.randint_like(
                self.env.episode_length_buf, high=int(self.env.max_episode_length)
            )
        obs = self.env.get_observations()
        self.alg.model.train()
        distributed.broadcast(self.alg.model)
        self.open_log()
        first = self.alg.iteration
        last = first + num_learning_iterations
        self.longest = 0.0
        self.late = False
        while self.alg.iteration < last:
            # Leave time for one more iteration as long as the longest, and for its checkpoint.
            lap_start = time.monotonic()
            remaining = start + time_budget_s - lap_start
            is_late = self.longest > 0.0 and remaining < 2.0 * self.longest
            if self._any_rank(self.stop.is_set() or is_late):
                self.late = not self._any_rank(self.stop.is_set())
                break
            obs = self._iterate(obs, first, last)
            self.longest = max(self.longest, time.monotonic() - lap_start)
            report()
            if self.alg.iteration % self.cfg["save_interval"] == 0 and self.alg.iteration < last:
                self.save()
        newest = self.save()
        self.logger.stop_logging_writer()
        return newest

    def open_log(self) -> None:
        """Open the files of the curves, if the run has a folder."""
        add_wandb_tags(self._agent["wandb_tags"])
        # Anew for each call: rsl_rl removes the class name from the dictionary.
        self.cfg["logger"] = {
            "class_name": "renet.training.metrics:CurvesWriter",
            "logger": self._agent["logger"],
            "project_name": self._agent["wandb_project"],
        }
        self.logger.init_logging_writer()

    def _iterate(self, obs: TensorDict, first: int, last: int) -> TensorDict:
        """Collect one rollout, update, and log; returns the observations after it."""
        # Collect a rollout, whose length follows from the batch size.
        start = time.monotonic()
        steps = steps_per_env(
            self._agent["num_steps_per_env"],
            self._agent["batch_size"],
            self.env.num_envs,
            self.alg.steps,
        )
        # rsl_rl's logger reads the number there.
        self.cfg["num_steps_per_env"] = steps
        for _ in range(steps):
            # An incomplete rollout is dropped: the checkpoint holds the state of the last update.
            if self.stop.is_set() and not self.is_distributed:
                return obs
            obs, rewards, dones, extras = self.env.step(self.alg.act(obs))
            # A sum below zero counts as zero, so that ending an episode early never pays
            # (Extreme Parkour).
            rewards = rewards.clamp_min(0.0)
            costs = mdp.constraint_costs(self._mjlab_env)
            self.alg.process_env_step(obs, rewards, dones, extras | {"costs": costs})
            self.logger.process_env_step(rewards, dones, extras, None)

        # Learn from it.
        learning_start = time.monotonic()
        self.alg.compute_returns(obs)
        losses = self.alg.update()
        self._check_learning(losses, obs)
        self.current_learning_iteration = self.alg.iteration

        # Log.
        self.logger.log(
            it=self.alg.iteration - 1,
            start_it=first,
            total_it=last,
            collect_time=learning_start - start,
            learn_time=time.monotonic() - learning_start,
            loss_dict=losses,
            # The mean over gradient steps, because the rate jumps from step to step.
            learning_rate=losses.pop("learning_rate", self.alg.np3o.learning_rate),
            action_std=self.alg.action_std,
            rnd_weight=None,
        )
        return obs

    def _check_learning(self, losses: dict[str, float], obs: TensorDict) -> None:
        """Raise RenetError if a loss is NaN or infinite, before the policy is saved.

        NaN or infinity in a rollout shows in the losses, so that steps need no check of their own.
        """
        bad_losses = [name for name, loss in losses.items() if not np.isfinite(loss)]
        if not self.alg.action_std.isfinite().all():
            bad_losses.append("action noise")
        if not self._any_rank(bool(bad_losses)):
            return
        bad_outputs = self.alg.not_finite(obs)
        if bad_outputs:
            raise RenetError(
                f"the task's {', '.join(bad_outputs)} became NaN or infinite in iteration "
                f"{self.alg.iteration}. Nothing of it was saved: mend the task, go on with "
                "--resume"
            )
        raise RenetError(
            f"learning diverged in iteration {self.alg.iteration}: "
            f"{', '.join(bad_losses) or 'a loss'} is not finite. Nothing of it was saved: go on "
            "with --resume and a smaller --agent.algorithm.learning-rate"
        )

    def _any_rank(self, flag: bool) -> bool:
        """Return True if a flag is set on any rank, so that all ranks decide alike."""
        return bool(distributed.mean(torch.tensor(float(flag), device=self.device)) > 0)

    # Checkpoints.

    def save(self, *_: Any) -> Path | None:  # type: ignore[override]
        """Write a checkpoint and return its folder; None on ranks above 0, or without a folder."""
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
        environment = mdp.curriculum_state(self._mjlab_env)
        environment["torch_rng"] = torch.get_rng_state()
        if self.device.startswith("cuda"):
            environment["cuda_rng"] = torch.cuda.get_rng_state(self.device)
        checkpoint = Checkpoint(
            model=algorithm.model.state_dict(),
            optimizer=checkpoints.optimizer_tensors(algorithm.optimizers),
            environment=environment,
            state=state,
            average=algorithm.average.module.state_dict(),
        )
        keep = self.cfg["keep_checkpoints"]
        return checkpoints.save(checkpoint, self.folder, algorithm.iteration, keep)

    def provenance(self) -> dict[str, Any]:
        """Return all that shaped the policy: task, both configurations, version of the code."""
        env = self._mjlab_env
        settings = {"agent": self._agent, "env": getattr(env, "task_cfg", env.cfg)}
        return {"task": self._agent["task"], **to_json(settings), "code": code_version()}

    def load(self, path: str, **_: Any) -> dict:  # type: ignore[override]
        """Continue from a checkpoint's folder; raises RenetError if it does not fit."""
        folder = checkpoints.find(Path(path))
        algorithm = self.alg
        state = checkpoints.load_state(folder)
        checkpoints.check_model(algorithm.model.cfg, state, folder)
        checkpoint = checkpoints.load_checkpoint(folder, self.device, algorithm.model)
        checkpoints.load_model(algorithm.model, checkpoint.model, folder)
        try:
            self._restore(checkpoint)
        except (KeyError, TypeError, ValueError) as error:
            raise RenetError(f"checkpoint {folder} is incomplete or damaged: {error}") from error
        return state

    def _restore(self, checkpoint: Checkpoint) -> None:
        """Restore all parts of a checkpoint but the model."""
        algorithm = self.alg
        state = checkpoint.state

        # Optimizers. A setting that the user changed is not replaced by its adapted value.
        checkpoints.load_optimizers(algorithm.optimizers, checkpoint.optimizer)
        old = state["agent"]["algorithm"]
        new = self._agent["algorithm"]
        for name in ("learning_rate", "cost_weight"):
            if old[name] == new[name]:
                setattr(algorithm.np3o, name, state[name])

        # Counts, the average and the logger.
        algorithm.iteration = state["iteration"]
        self.current_learning_iteration = algorithm.iteration
        algorithm.steps = state["steps"]
        algorithm.average.load(checkpoint.exported, state.get("averaged", algorithm.iteration))
        self.logger.tot_timesteps = state["steps"]
        self.logger.tot_time = state["seconds"]

        # Random numbers of rank 0, the only one that saves; other ranks draw their own.
        environment = checkpoint.environment
        torch_rng = environment.pop("torch_rng")
        cuda_rng = environment.pop("cuda_rng", None)
        if self.gpu_global_rank == 0:
            torch.set_rng_state(torch_rng.cpu())
            if cuda_rng is not None and self.device.startswith("cuda"):
                torch.cuda.set_rng_state(cuda_rng.cpu(), self.device)
        self.restore_curriculum(environment)

    def restore_curriculum(self, state: dict[str, torch.Tensor]) -> None:
        """Put the robots on the levels of a checkpoint's environment, unless it is empty."""
        if state:
            mdp.load_curriculum_state(self._mjlab_env, state, self.alg.steps)
            cast(Any, self.env).reset()
