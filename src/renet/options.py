"""Options of commands whose own modules need PyTorch, so that `--help` need not load it."""

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass(kw_only=True)
class ExportCfg:
    """Turn a checkpoint into a bundle: three ONNX models and a manifest."""

    checkpoint: tyro.conf.Positional[Path]
    """Checkpoint folder, or a run folder whose newest checkpoint is taken."""
    out: Path = Path("bundle")
    """Folder of the bundle; replaced if it already is one."""
    beta: float = 0.01
    """Selector threshold until `renet calibrate` measures one."""
