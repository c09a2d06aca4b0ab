"""One thin door: `renet <command>`; every command is a dataclass and a function elsewhere.

Commands are imported only when called, so that the robot's install needs no training packages.
"""

from __future__ import annotations

import difflib
import importlib
import os
import sys
from dataclasses import dataclass
from pathlib import Path

from renet import __version__
from renet.errors import RenetError

SIGPIPE_CODE = 141
"""Exit code of a program whose reader left, as shells count it."""


@dataclass(frozen=True)
class Command:
    """`module` holds the dataclass `config` and the function `run(config)`."""

    help: str
    module: str
    config: str
    run: str
    extra: str = ""
    """What to install if the module's imports are missing."""


COMMANDS = {
    "demo": Command(
        "break the shipped policy's camera and watch it keep walking: one HTML page",
        "renet.evaluation.demo",
        "DemoCfg",
        "run_demo",
        "train",
    ),
    "train": Command(
        "train RENet on a CPU or GPUs", "renet.training.launch", "TrainCfg", "launch", "train"
    ),
    "average": Command(
        "the mean of a run's last checkpoints, steadier than each of them",
        "renet.training.average",
        "AverageCfg",
        "average",
        "train",
    ),
    "export": Command(
        "turn a checkpoint into a bundle of three ONNX models",
        "renet.training.bundle",
        "ExportCfg",
        "export",
        "train",
    ),
    "play": Command(
        "watch a bundle or a checkpoint live in the browser, or film it",
        "renet.evaluation.play",
        "PlayCfg",
        "run_play",
        "train",
    ),
    "deploy": Command(
        "put a bundle on a robot, simulated or real; leaves a recording and its timeline",
        "renet.deploy.main",
        "DeployCfg",
        "deploy",
        "sim",
    ),
    "calibrate": Command(
        "measure the selector's threshold on healthy runs and store it in a bundle",
        "renet.evaluation.calibrate",
        "CalibrateCfg",
        "run_calibrate",
        "train",
    ),
    "evaluate noise": Command(
        "the paper's noise study: VP alone against RENet",
        "renet.evaluation.noise",
        "NoiseCfg",
        "main",
        "train",
    ),
    "evaluate terrain": Command(
        "the paper's table: highest levels on gap, platform and stairs",
        "renet.evaluation.terrain",
        "TerrainCfg",
        "main",
        "train",
    ),
    "evaluate success": Command(
        "success rate against size for gaps, platforms and stairs, one try each",
        "renet.evaluation.success",
        "SuccessCfg",
        "main",
        "train",
    ),
    "evaluate standing": Command(
        "whether a robot that is told to stand does, and looks still",
        "renet.evaluation.standing",
        "StandingCfg",
        "main",
        "train",
    ),
    "evaluate course": Command(
        "a kilometre unattended: grass, stairs, slopes, platforms, gaps, an occlusion",
        "renet.evaluation.course",
        "CourseCfg",
        "main",
        "train",
    ),
    "evaluate faults": Command(
        "every way a depth camera fails, at every severity, in every mode",
        "renet.evaluation.fault_study",
        "FaultsCfg",
        "main",
        "train",
    ),
    "evaluate filter": Command(
        "the filter's switching delay and number of switches against gamma and rate",
        "renet.evaluation.filter_study",
        "FilterCfg",
        "main",
        "train",
    ),
    "evaluate log": Command(
        "score a recording: falls, distance, switches, delays, and its timeline",
        "renet.deploy.score",
        "ScoreCfg",
        "score_log",
    ),
    "evaluate report": Command(
        "put every study found in a folder on one self-contained page",
        "renet.evaluation.report",
        "ReportCfg",
        "main",
        "train",
    ),
    "evaluate pictures": Command(
        "pictures of every tile and of the camera's errors",
        "renet.evaluation.pictures",
        "PicturesCfg",
        "run_pictures",
        "train",
    ),
    "bundle inspect": Command(
        "print every input of a bundle by index: name, unit, scale, joint order",
        "renet.deploy.bundle.inspect",
        "InspectCfg",
        "inspect",
    ),
}


def main(argv: list[str] | None = None) -> int:
    """Run a command line; returns the exit code (2 for anything the user can put right)."""
    arguments = sys.argv[1:] if argv is None else argv
    # A spinning OpenMP team starves whatever shares the machine; must be set before torch loads.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    try:
        try:
            return _run(arguments)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # `renet … | head`: nobody reads on, and what is still held back must not raise at exit.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())
        return SIGPIPE_CODE


def _run(arguments: list[str]) -> int:
    """Run a command; what the user can put right becomes one line."""
    try:
        return _dispatch(arguments)
    except RenetError as error:
        print(f"renet: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("renet: interrupted", file=sys.stderr)
        return 130


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_help(arguments))
        return 0
    if arguments[0] == "--version":
        print(__version__)
        return 0
    name, rest = _match(arguments)
    command = COMMANDS[name]
    try:
        module = importlib.import_module(command.module)
        import tyro

        cfg = tyro.cli(getattr(module, command.config), args=rest, prog=f"renet {name}")
        result = getattr(module, command.run)(cfg)
    except ModuleNotFoundError as error:
        # Also of imports that wait until an option needs them.
        if error.name and error.name.startswith("renet"):
            raise
        raise RenetError(
            f"`renet {name}` needs {error.name}: pip install 'renet-locomotion[{command.extra}]'"
        ) from error
    where = result if isinstance(result, Path) else getattr(cfg, "out", None)
    if where is not None:
        print(f"Results: {where}")
    return 0


def _match(arguments: list[str]) -> tuple[str, list[str]]:
    """The command (one or two words) and its own arguments."""
    two_words = " ".join(arguments[:2])
    if two_words in COMMANDS:
        return two_words, arguments[2:]
    if arguments[0] in COMMANDS:
        return arguments[0], arguments[1:]
    group = [name for name in COMMANDS if name.split()[0] == arguments[0]]
    if group:
        if len(arguments) == 1 or arguments[1] in ("-h", "--help"):
            print(_help(arguments))
            raise SystemExit(0)
        raise RenetError(f"unknown command {two_words!r}: choose one of {', '.join(group)}")
    close = difflib.get_close_matches(arguments[0], COMMANDS, n=1)
    hint = f"did you mean `renet {close[0]}`?" if close else "see `renet --help`"
    raise RenetError(f"unknown command {arguments[0]!r}: {hint}")


def _help(arguments: list[str]) -> str:
    group = arguments[0] if arguments and not arguments[0].startswith("-") else ""
    rows = [(n, c.help) for n, c in COMMANDS.items() if not group or n.split()[0] == group]
    width = max(len(name) for name, _ in rows)
    lines = [f"renet {__version__}: quadruped locomotion that survives the loss of its camera", ""]
    lines += [f"  renet {name:<{width}}  {text}" for name, text in rows]
    return "\n".join([*lines, "", "`renet <command> --help` shows every option with its default."])


if __name__ == "__main__":
    raise SystemExit(main())
