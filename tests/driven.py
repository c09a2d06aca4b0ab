"""The policy on trial that follows velocities in all directions, exported from its checkpoint."""

from pathlib import Path

CHECKPOINT = Path(__file__).parents[1] / "benchmarks" / "results" / "driving" / "checkpoint"


def driven_bundle(folder: Path) -> Path:
    """Its bundle go1-driven in a folder; needs renet-locomotion[train]."""
    from renet.training.export import ExportCfg, export

    return export(ExportCfg(checkpoint=CHECKPOINT, out=folder / "go1-driven"))
