"""Evaluation of bundles: closed-loop rollouts under camera faults, studies, figures and tables.

A run, from the robots to the numbers:

- `env` simulates robots, under `conditions`; `motion` reads their true motion.
- `evaluator` makes the policy under study and its environments.
- `rollout` lets a pilot drive the robots while cameras fail, and keeps a `trace`.
- `monitor_log` keeps the scores of the monitors in a run.
- `metrics` are measures of traces.

A study, from the numbers to the page:

- `study` is the base of all studies, with `settings` that they share; `jobs` makes their parts in
  several processes.
- `results` and `figures` are the files that they write.
- `studies` has one module for each study, `benchmark` the fault benchmark, `adapters` policies of
  other projects.

Other commands: `calibrate` with `calibrate_memory`, `curves`, `play` and `demo`. Films are made by
`video`, whose pictures `painter` draws; `live` shows a run in a window.
"""
