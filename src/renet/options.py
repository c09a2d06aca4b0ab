"""Options of commands whose own modules need PyTorch, so that `--help` need not load it."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from renet.interface import Engine

TASK = "Renet-Go1-Parkour"


@dataclass(kw_only=True)
class TrainOptions:
    """Train RENet.

    The settings of a task are options, too: `--agent.NAME` and `--env.NAME`, which mjlab's
    `train TASK --help` lists. `renet recipe` prints them with their values.
    """

    task: tyro.conf.Positional[str]
    """Task id: Renet-Go1-Parkour (the recipe), Renet-Go1-Parkour-Paper (the paper's settings, for
    1.5 billion steps), Renet-Go1-Flat, or one registered by a plug-in."""
    num_envs: int | None = None
    """Robots of each process, short for --env.scene.num-envs; by default 512 on a CPU and 4096 on a
    GPU (paper)."""
    resume: str | None = None
    """Run folder or checkpoint to go on from, with its settings; `latest` takes the newest run of
    this task."""
    time_budget: str | None = None
    """Stop cleanly, with a checkpoint, before this much time has passed (90s, 25m, 8h), but not
    before one iteration is done."""
    log_root: Path | None = None
    """Folder that receives a folder per run; by default `logs`, or where the run to go on from is.
    Another one than that run's branches off: the run itself stays as it is."""
    device: str = "auto"
    """cpu, cuda:0, ... or auto (a GPU if there is one)."""
    engine: Engine = "auto"
    """Physics engine; auto: native (C MuJoCo on threads) on a CPU, warp on a GPU."""


@dataclass(kw_only=True)
class RecipeCfg:
    """Print how a checkpoint was trained, or how `renet train` would begin now, as JSON."""

    checkpoint: tyro.conf.Positional[Path | None] = None
    """Checkpoint, or a run folder whose newest checkpoint is taken; by default, the recipe of a run
    that would begin now."""
    task: str = TASK
    """Task of the run that would begin now."""


@dataclass(kw_only=True)
class ExportCfg:
    """Turn a checkpoint into a bundle: three ONNX models and a manifest."""

    checkpoint: tyro.conf.Positional[Path]
    """Checkpoint folder, or a run folder whose newest checkpoint is taken."""
    out: Path = Path("bundle")
    """Folder of the bundle; replaced if it already is one."""
    beta: float = 0.01
    """Selector threshold until `renet calibrate` measures one."""
