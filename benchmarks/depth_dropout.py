"""Trains one policy on cameras that fail: `renet train` with `--agent.depth-dropout.share`."""

import sys

from baselines.depth_dropout import TASK
from renet.cli import main

if __name__ == "__main__":
    raise SystemExit(main(["train", TASK, *sys.argv[1:]]))
