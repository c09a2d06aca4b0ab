"""Studies: settings, measures, figures and tables of each.

- `faults`: every camera fault on every ground. Its settings, measures and findings are in
  `fault_settings`, `fault_metrics` and `fault_findings`; `noise` is its preset.
- `memory`: time for which robots find their way without an image; `reach` is its preset.
- `terrain`: levels that a policy crosses; `standing`, `stops` and `backing` are its presets.
- `commands`: errors with which robots follow velocities.
- `camera_use`: whether a policy uses its camera.
- `margins`: how far a robot may differ from the simulated one.

`grounds` is what they know of tiles. Their base is `evaluation.study`.
"""
