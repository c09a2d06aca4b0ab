"""`renet train` in several processes, one per GPU, on this machine or on several."""

import logging
import os
from functools import partial
from pathlib import Path

from renet.errors import RenetError
from renet.training.train import LOGS, TrainCfg, train

COPIED = ("MUJOCO*", "OMP*", "GLOO*")
"""Environment variables every worker inherits, besides torchrunx's own choice."""


def launch(cfg: TrainCfg) -> Path | None:
    """Train here, or start `processes` workers on every host and wait for them.

    A process that another launcher started (torchrun, Slurm: anything that sets RANK) is a worker.

    Raises:
        RenetError: anything a user can put right, in any worker.
    """
    if cfg.processes < 1 or not cfg.hosts:
        raise RenetError("--processes must be at least 1 and --hosts must name a machine")
    if cfg.processes * len(cfg.hosts) == 1 or "RANK" in os.environ:
        return train(cfg)
    import torchrunx

    logging.basicConfig(level=logging.INFO, format="%(message)s")
    launcher = torchrunx.Launcher(
        hostnames=list(cfg.hosts),
        workers_per_host=cfg.processes,
        backend=None,  # The runner joins its own process group.
        copy_env_vars=(*torchrunx.DEFAULT_ENV_VARS_FOR_COPY, *COPIED),
        extra_env_vars={"OMP_NUM_THREADS": str(max(1, (os.cpu_count() or 1) // cfg.processes))},
    )
    launcher.set_logging_handlers(partial(_handlers, cfg))
    try:
        return launcher.run(worker, cfg).rank(0)
    except torchrunx.WorkerFailedError as error:
        logs = (cfg.log_root or LOGS) / "workers"
        raise RenetError(f"a process failed: what each one said is in {logs}") from error
    except (OSError, torchrunx.AgentFailedError) as error:
        why = str(error) or type(error).__name__
        raise RenetError(f"training on {', '.join(cfg.hosts)} failed: {why}") from error


def worker(cfg: TrainCfg) -> Path | None:
    """`train`; one that fails must exit: torchrunx lets others wait for one that only raises."""
    try:
        return train(cfg)
    except Exception as error:
        raise SystemExit(f"{type(error).__name__}: {error}") from error


def _handlers(cfg: TrainCfg) -> list[logging.Handler]:
    """Every worker's output in a file of its own, the first one's on the terminal as well.

    Not the agents': torchrunx stops them with a signal at the end, which they report as an error.
    """
    from torchrunx.utils.log_handling import RedirectHandler, file_handlers, get_handler_filter

    terminal = RedirectHandler()
    terminal.addFilter(get_handler_filter(cfg.hosts[0], local_rank=0))
    workers = [cfg.processes] * len(cfg.hosts)
    return [
        terminal,
        *file_handlers(list(cfg.hosts), workers, log_dir=(cfg.log_root or LOGS) / "workers"),
    ]
