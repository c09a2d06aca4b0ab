"""Learning, from settings to a bundle.

| part | modules |
|---|---|
| settings | `config`, which `recipe` fills in; `config_file` for `--config` |
| command | `train`; `runs` for folders and signals; `progress` and `films` beside it |
| loop | `runner`, `algorithm`, `storage`, `withholding` |
| learning | `np3o` for the actor and `supervision` for estimators and detector; `grass` |
| machine | `precision`, `distributed` |
| results | `checkpoint`, `provenance`, `average`, `metrics`, `export` |
"""

import mjlab  # noqa: F401  Loads renet.registry, which needs this package: see renet.sim.
