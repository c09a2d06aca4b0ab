"""Trains one policy on cameras that fail: `renet train` with `--depth-dropout.share`."""

import sys

import tyro

from baselines.depth_dropout import DropoutCfg
from facts import errors_in_one_line
from renet.training.train import train

if __name__ == "__main__":
    with errors_in_one_line():
        train(tyro.cli(DropoutCfg, default=DropoutCfg.defaults(sys.argv[1:])))
