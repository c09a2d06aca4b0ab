"""The command line, `renet <command>`; every command is a dataclass and a function elsewhere.

Commands are imported only when called, so that the robot's install needs no training packages.
"""

import argparse
import difflib
import importlib
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

from renet import __version__
from renet.errors import RenetError

SIGPIPE_CODE = 141
"""Exit code of a program whose reader left, as shells count it."""


@dataclass(frozen=True)
class Command:
    """A function and the dataclass of options that it is called with."""

    help: str
    target: str
    """MODULE:CONFIG:FUNCTION."""
    extra: str = "train"
    """What to install if the module's imports are missing."""
    presets: dict[str, str] = field(default_factory=dict)
    """MODULE:CONFIG with other defaults, by what follows `--preset`."""

    def load(self, arguments: list[str]) -> tuple[Callable[[Any], Any], Any, list[str]]:
        """The function, the dataclass that `--preset` asks for, and the other arguments."""
        module, config, function = self.target.split(":")
        run = attrgetter(function)(importlib.import_module(module))
        if self.presets:
            parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
            parser.add_argument("--preset", nargs="?", const="")
            asked, arguments = parser.parse_known_args(arguments)
            if asked.preset not in (None, *self.presets):
                known = ", ".join(self.presets)
                raise RenetError(f"unknown preset {asked.preset!r}: choose one of {known}")
            if asked.preset:
                module, config = self.presets[asked.preset].split(":")
        return run, getattr(importlib.import_module(module), config), arguments


COMMANDS = {
    "demo": Command(
        "break the shipped policy's camera and watch it keep walking: one HTML page",
        "renet.evaluation.demo:DemoCfg:run_demo",
    ),
    "page": Command(
        "the page that runs a bundle in the browser, and lets visitors break its camera",
        "renet.page.writer:PageCfg:run_page",
        "sim",
    ),
    "train": Command("train RENet on a CPU or GPUs", "renet.training.train:TrainCfg:train"),
    "recipe": Command(
        "print the whole recipe: of a checkpoint, or of a run that would begin now",
        "renet.training.train:RecipeCfg:show",
    ),
    "export": Command(
        "turn a checkpoint into a bundle of three ONNX models",
        "renet.training.export:ExportCfg:export",
    ),
    "play": Command(
        "film a bundle or a checkpoint on any tile, while its camera fails",
        "renet.evaluation.play:PlayCfg:run_play",
    ),
    "deploy": Command(
        "put a bundle on a robot, simulated or real; leaves a recording and its timeline",
        "renet.deploy.main:DeployCfg:deploy",
        "sim",
    ),
    "calibrate": Command(
        "measure the selector's threshold on healthy runs and store it in a bundle",
        "renet.evaluation.calibrate:CalibrateCfg:run_calibrate",
    ),
    "evaluate faults": Command(
        "every way a depth camera fails; --preset noise: the paper's noise figure",
        "renet.evaluation.studies.faults:FaultStudy:FaultStudy.main",
        presets={"noise": "renet.evaluation.studies.noise:NoiseStudy"},
    ),
    "evaluate leaderboard": Command(
        "rank policies by their result files of the fault benchmark",
        "renet.evaluation.studies.leaderboard:LeaderboardCfg:make_leaderboard",
    ),
    "evaluate terrain": Command(
        "highest levels (the paper's table); --preset success: one try; standing: robots stop",
        "renet.evaluation.studies.terrain:TerrainStudy:TerrainStudy.main",
        presets={
            "success": "renet.evaluation.studies.terrain:SuccessStudy",
            "standing": "renet.evaluation.studies.standing:StandingStudy",
        },
    ),
    "evaluate memory": Command(
        "who crosses, against the seconds without an image",
        "renet.evaluation.studies.memory:MemoryStudy:MemoryStudy.main",
    ),
    "evaluate margins": Command(
        "how far a robot may be from the simulated one before the policy falls",
        "renet.evaluation.studies.margins:MarginsStudy:MarginsStudy.main",
    ),
    "evaluate log": Command(
        "score a recording: falls, distance, switches, delays, and its timeline",
        "renet.deploy.score:ScoreCfg:score_log",
        "",
    ),
    "evaluate report": Command(
        "put every study found in a folder on one self-contained page",
        "renet.evaluation.studies.report:ReportCfg:make_report",
    ),
    "bundle inspect": Command(
        "print every input of a bundle by index: name, unit, scale, joint order",
        "renet.bundle.inspect:InspectCfg:inspect",
        "",
    ),
    "bundle card": Command(
        "write a bundle's model card from its files and its studies' results",
        "renet.deploy.card:CardCfg:write_card",
        "",
    ),
}


def main(argv: list[str] | None = None) -> int:
    """Run a command line; returns the exit code (2 for anything the user can put right)."""
    arguments = sys.argv[1:] if argv is None else argv
    # A spinning OpenMP team starves whatever shares the machine; must be set before torch loads.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    try:
        return _run(arguments)
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
    except (RenetError, OSError) as error:
        if getattr(error, "filename", "") is None:  # About no file that the user named.
            raise
        print(f"renet: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("renet: interrupted", file=sys.stderr)
        return 130
    finally:
        sys.stdout.flush()


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
        run, config, rest = command.load(rest)
        import tyro

        given = {"default": config.defaults(rest)} if hasattr(config, "defaults") else {}
        cfg = tyro.cli(config, args=rest, prog=f"renet {name}", **given)
        result = run(cfg)
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
    for words in (2, 1):
        name = " ".join(arguments[:words])
        if name in COMMANDS:
            return name, arguments[words:]
    group = [name for name in COMMANDS if name.split()[0] == arguments[0]]
    if group:
        if len(arguments) == 1 or arguments[1] in ("-h", "--help"):
            print(_help(arguments))
            raise SystemExit(0)
        asked = " ".join(arguments[:2])
        raise RenetError(f"unknown command {asked!r}: choose one of {', '.join(group)}")
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
