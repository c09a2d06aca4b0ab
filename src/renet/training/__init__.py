"""Learning: N-P3O, supervision, choice of the estimator, checkpoints, export."""

import mjlab  # noqa: F401  Loads renet.registry, which needs this package: see renet.sim.
