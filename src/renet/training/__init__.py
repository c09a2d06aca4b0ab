"""How it is learned: N-P3O, supervision, modality schedule, checkpoints, export."""

import mjlab  # noqa: F401  Loads renet.registry, which needs this package: see renet.sim.
