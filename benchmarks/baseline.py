"""`renet` with the tasks of the baselines: `python benchmarks/baseline.py train TASK`."""

import sys

from baselines import depth_dropout, zhuang  # noqa: F401  register their tasks
from renet.cli import main

if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
