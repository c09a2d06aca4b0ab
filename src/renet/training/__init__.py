"""How it is learned: N-P3O, supervision, modality schedule, checkpoints, export."""
