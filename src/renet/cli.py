"""Command line `renet <command>`; a command is a dataclass of options and a function elsewhere.

Commands are imported when they are called, so that a robot needs no training packages.
"""

import argparse
import importlib
import io
import os
import re
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass, field, fields, is_dataclass
from functools import partial
from itertools import chain, groupby, takewhile
from operator import attrgetter
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from renet import __version__
from renet.errors import RenetError, demand_name, install, obstacle, printable, reason, unknown_name
from renet.program import remember_program

HELP_ALL = "--help-all"
"""Option that also lists the settings of a task, for which PyTorch is loaded."""
SIGPIPE_CODE = 141
"""Exit code of a program whose reader has left, as in shells."""


@dataclass(frozen=True)
class Command:
    """Command: a function and the dataclass of its options."""

    help: str
    target: str
    """Module, dataclass and function, MODULE:CONFIG:FUNCTION."""
    extra: str = "train"
    """Extra of `pyproject.toml` with the packages that the command needs."""
    group: str = "Measure"
    """Heading in `renet --help`."""
    presets: dict[str, str] = field(default_factory=dict)
    """Dataclasses with other defaults, MODULE:CONFIG, by the value of `--preset`."""
    resume: str = ""
    """Message after an interruption: its consequences, and how to continue."""
    options: str = ""
    """Dataclass MODULE:CONFIG of a command that loads PyTorch. It needs no PyTorch: `--help` shows
    it, and mistakes are found with it first."""
    beginning: str = ""
    """Line to print at once, by a command that is silent for long."""

    def check(self, arguments: list[str], program: str) -> None:
        """Find mistakes without PyTorch, and print the beginning.

        Raises RenetError for a mistake, or exits with code 2, as tyro does.
        """
        if not self.options or {"-h", "--help", HELP_ALL}.intersection(arguments):
            return
        module, config = self.options.split(":")
        options = getattr(importlib.import_module(module), config)
        known = options.known(arguments) if hasattr(options, "known") else arguments
        cfg = parse(options, known, program)
        if hasattr(cfg, "check"):
            cfg.check()
        # Of several processes that train together, the first one speaks.
        if self.beginning and os.environ.get("RANK", "0") == "0":
            print(self.beginning, flush=True)

    def load(self, arguments: list[str]) -> tuple[Callable[[Any], Any], Any, list[str]]:
        """Import the function and the dataclass, and return them with the remaining arguments."""
        module, config, function = self.target.split(":")
        if self.options and not {"-h", "--help"}.isdisjoint(arguments):
            module, config = self.options.split(":")
            return print, getattr(importlib.import_module(module), config), ["--help"]
        arguments = ["--help" if argument == HELP_ALL else argument for argument in arguments]
        run = attrgetter(function)(importlib.import_module(module))
        if self.presets:
            parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
            parser.add_argument("--preset", nargs="?", const="")
            options, arguments = parser.parse_known_args(arguments)
            if options.preset not in (None, *self.presets):
                raise unknown_name("preset", options.preset, self.presets)
            if options.preset:
                module, config = self.presets[options.preset].split(":")
        return run, getattr(importlib.import_module(module), config), arguments

    def program(self, name: str, config: Any) -> str:
        """Return the words that call the command with a dataclass of options, such as a preset's.

        Args:
            name: Name of the command.
            config: The dataclass.
        """
        for preset, target in self.presets.items():
            if target.endswith(f":{config.__name__}"):
                return f"renet {name} --preset {preset}"
        return f"renet {name}"


KEPT = "what has finished is kept: the same command goes on"
AT_ONCE = "nothing is half-written: give the same command again"
_walk = partial(Command, group="Walk")
_train = partial(Command, group="Train")
_study = partial(Command, resume=KEPT)
_bundle = partial(Command, extra="", group="Bundles")
COMMANDS = {
    "demo": _walk(
        "see who crosses a gap with an unplugged camera",
        "renet.evaluation.demo:DemoStudy:run_demo",
        resume=KEPT,
    ),
    "play": _walk(
        "film any policy while its camera fails",
        "renet.evaluation.play:PlayCfg:run_play",
    ),
    "deploy": _walk(
        "run a bundle on a robot, simulated or real",
        "renet.deploy.main:DeployCfg:deploy",
        "sim",
    ),
    "simulate": _walk(
        "run a simulated Go2 behind its DDS topics",
        "renet.deploy.robots.go2.simulate:SimulateCfg:simulate",
        "sim,go2",
    ),
    "page": _walk(
        "walk in the browser and break the camera there",
        "renet.page.writer:PageCfg:run_page",
        "sim",
    ),
    "train": _train(
        "train a policy on a CPU or on GPUs",
        "renet.training.train:TrainCfg:train_command",
        options="renet.options:UsualOptions",
        beginning="Loading PyTorch and building the task; this takes a minute or two",
    ),
    "recipe": _train(
        "print every setting of a checkpoint or a new run",
        "renet.training.train:RecipeCfg:show_recipe",
        options="renet.options:RecipeCfg",
    ),
    "export": _train(
        "turn a checkpoint into a bundle of ONNX models",
        "renet.training.export:ExportCfg:export",
        resume=AT_ONCE,
        options="renet.options:ExportCfg",
    ),
    "calibrate": _train(
        "set a bundle's fault detection from healthy walks",
        "renet.evaluation.calibrate:CalibrateCfg:run_calibrate",
        resume=AT_ONCE,
    ),
    "identify": _train(
        "measure a robot's motors in a log of its joints",
        "renet.identification.identify:IdentifyCfg:identify",
        resume=AT_ONCE,
    ),
    "evaluate faults": _study(
        "all camera faults; --preset noise: the paper's six",
        "renet.evaluation.studies.faults:FaultStudy:FaultStudy.main",
        presets={"noise": "renet.evaluation.studies.noise:NoiseStudy"},
    ),
    "evaluate benchmark": _study(
        "renet-faults: any policy while its camera fails",
        "renet.evaluation.benchmark.study:BenchmarkStudy:BenchmarkStudy.main",
    ),
    "evaluate leaderboard": Command(
        "rank policies by their results of the benchmark",
        "renet.evaluation.benchmark.leaderboard:LeaderboardCfg:make_leaderboard",
    ),
    "evaluate terrain": _study(
        "highest levels; --preset success, stops and more",
        "renet.evaluation.studies.terrain:TerrainStudy:TerrainStudy.main",
        presets={
            "success": "renet.evaluation.studies.terrain:SuccessStudy",
            "dawn": "renet.evaluation.studies.terrain:DawnStudy",
            "standing": "renet.evaluation.studies.standing:StandingStudy",
            "stops": "renet.evaluation.studies.stops:StopsStudy",
            "backing": "renet.evaluation.studies.backing:BackingStudy",
        },
    ),
    "evaluate commands": _study(
        "how closely robots follow what they are told",
        "renet.evaluation.studies.commands:CommandStudy:CommandStudy.main",
    ),
    "evaluate memory": _study(
        "who crosses without images; --preset reach",
        "renet.evaluation.studies.memory:MemoryStudy:MemoryStudy.main",
        presets={"reach": "renet.evaluation.studies.reach:ReachStudy"},
    ),
    "evaluate camera-use": _study(
        "whether and where a policy uses its camera",
        "renet.evaluation.studies.camera_use:CameraUseStudy:CameraUseStudy.main",
    ),
    "evaluate margins": _study(
        "how far a robot may differ before it falls",
        "renet.evaluation.studies.margins:MarginsStudy:MarginsStudy.main",
    ),
    "evaluate curves": Command(
        "draw training runs, seeds together",
        "renet.evaluation.curves:CurvesCfg:make_curves",
    ),
    "evaluate log": Command(
        "score a recording: falls, distance, switches",
        "renet.deploy.recording.score:ScoreCfg:score_log",
        "",
    ),
    "bundle inspect": _bundle(
        "print a bundle's inputs by index, name and unit",
        "renet.bundle.inspect:InspectCfg:inspect",
    ),
    "bundle card": _bundle(
        "write a bundle's model card",
        "renet.bundle.card:CardCfg:write_card",
    ),
    "bundle push": Command(
        "put a bundle on the Hugging Face Hub",
        "renet.bundle.push:PushCfg:push",
        "hub",
        "Bundles",
    ),
}


def main(argv: list[str] | None = None) -> int:
    """Run a command line and return the exit code, 2 for errors that the user can correct."""
    if argv is None:
        remember_program()
    arguments = sys.argv[1:] if argv is None else argv
    for stream in (sys.stdout, sys.stderr):
        # A terminal of ASCII shows ? in place of an arrow, which is no error.
        with suppress(AttributeError):
            stream.reconfigure(errors="replace")
    # Idle OpenMP threads would otherwise occupy processors. It must be set before torch is loaded.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    # No command uses OpenGL. Without it, or with a misspelt choice, importing MuJoCo would fail.
    os.environ["MUJOCO_GL"] = "disable"
    interrupts: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        interrupts.append(number)
        raise KeyboardInterrupt

    # A command that is ended closes what it holds, such as a terminal without an echo.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        main_thread = threading.current_thread() is threading.main_thread()
        if main_thread and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, interrupt)
    try:
        return _run(arguments, interrupts)
    except BrokenPipeError:
        # As with `renet … | head`, which reads no further.
        code = SIGPIPE_CODE
        streams = (sys.stdout, sys.stderr)
    except OSError as error:
        # Standard output cannot be written, for example to a full disk.
        print(f"renet: {reason(error)}", file=sys.stderr)
        code = 2
        streams = (sys.stdout,)
    # Buffered output must not raise again at exit.
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in streams:
        with suppress(OSError, AttributeError):
            os.dup2(nowhere, stream.fileno())
    return code


def _run(arguments: list[str], interrupts: list[int]) -> int:
    """Run a command; an error that the user can correct becomes one line."""
    try:
        return _dispatch(arguments)
    except (RenetError, OSError) as error:
        # An OSError without a file is not about one that the user named.
        if getattr(error, "filename", "") is None:
            raise
        named = getattr(error, "filename", None)
        text = f"{named}: {obstacle(error, Path(named))}" if named else reason(error)
        print(f"renet: {printable(text)}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, Exception) as error:
        # Native modules turn an interrupt during their import into an ImportError.
        if not (interrupts or isinstance(error, KeyboardInterrupt)):
            raise
        why = str(error) if isinstance(error, KeyboardInterrupt) else ""
        print(": ".join(filter(None, ("renet: interrupted", why))), file=sys.stderr)
        return 130
    finally:
        # With `renet … >&-` there is no standard output.
        if sys.stdout is not None:
            sys.stdout.flush()


def _dispatch(arguments: list[str]) -> int:
    """Run the command that the arguments name; returns the exit code."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_help(""))
        return 0
    if arguments[0] == "--version":
        print(__version__)
        return 0
    if arguments[0] == "--print-completion":
        return _print_completion(arguments[1:])
    name, rest = _match(arguments)
    if name not in COMMANDS:
        print(_help(name))
        return 0
    command = COMMANDS[name]
    try:
        command.check(rest, f"renet {name}")
        run, config, rest = command.load(rest)
        cfg = parse(config, rest, command.program(name, config))
        result = run(cfg)
    except ModuleNotFoundError as error:
        # Some modules are imported only if an option needs them.
        raise _missing(error, name, command.extra) from error
    except KeyboardInterrupt as interrupt:
        raise KeyboardInterrupt(str(interrupt) or command.resume) from interrupt
    where = result if isinstance(result, Path) else getattr(cfg, "out", None)
    # A command may return a sentence to print in place of its output's path.
    if where is not None:
        print(result if isinstance(result, str) else f"Results: {where}")
    return 0


def parse(config: Any, arguments: list[str], program: str) -> Any:
    """Build the dataclass `config` from arguments; for mistakes tyro exits with code 2."""
    import tyro

    # With DisallowNone, help shows an option of default None as `PATH`, not as `{None}|PATH`.
    options = getattr(config, "tyro_flags", (tyro.conf.DisallowNone,))
    arguments = _with_positional_bundle(config, arguments)
    default = _default(config, arguments)
    _demand_used(config, arguments, program)
    _demand_choices(default.get("default", config), arguments)
    return tyro.cli(config, args=arguments, prog=program, config=options, **default)


def _with_positional_bundle(config: Any, arguments: list[str]) -> list[str]:
    """Put the value of `--bundle`, as studies call it, first where a command's bundle has no name.

    The other arguments and a `--bundle` without a value are left to tyro.
    """
    kinds = {option.name: str(option.type) for option in fields(config)}
    if "Positional" not in kinds.get("bundle", ""):
        return arguments
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--bundle", nargs="?")
    options, others = parser.parse_known_args(arguments)
    return arguments if options.bundle is None else [options.bundle, *others]


def _demand_used(config: Any, arguments: list[str], program: str) -> None:
    """Raise RenetError for an option that other commands have, and this one has no use for.

    The dataclass names them in `unused`, and hides them from tyro, which would know no such option.
    """
    for name in getattr(config, "unused", ()):
        option = f"--{name.replace('_', '-')}"
        if any(argument.partition("=")[0] == option for argument in arguments):
            raise RenetError(f"`{program}` has no use for {option}: leave it out")


def _demand_choices(config: Any, arguments: list[str]) -> None:
    """Raise RenetError for an unknown name of an option that has a few names to choose from.

    tyro would list them in a box, without the nearest one.

    Args:
        config: The command's dataclass, or an object of it with the defaults.
        arguments: The command's arguments.
    """
    kinds = get_type_hints(config if isinstance(config, type) else type(config))
    # The options of a robot and of a camera are those of the objects among the defaults.
    for name in list(kinds):
        part = getattr(config, name, None)
        if is_dataclass(part):
            kinds |= get_type_hints(type(part))
    for name, kind in kinds.items():
        choices = _choices(kind)
        option = f"--{name.replace('_', '-')}"
        for place, argument in enumerate(arguments):
            written, equals, value = argument.partition("=")
            if not choices or written.replace("_", "-") != option:
                continue
            following = takewhile(lambda word: not word.startswith("-"), arguments[place + 1 :])
            values = [value] if equals else list(following)
            if get_origin(kind) is not tuple:
                # What follows a single value is no value of this option.
                values = values[:1]
            for value in values:
                demand_name(option, value, choices)


def _choices(kind: Any) -> tuple[str, ...]:
    """Return the names that a type allows, alone or in a tuple; empty if it has other values."""
    parts = [part for part in get_args(kind) if part not in (type(None), ...)]
    if get_origin(kind) is Literal:
        return tuple(parts) if all(isinstance(name, str) for name in parts) else ()
    # A tuple of names, names or None, or names of two kinds.
    choices = list(map(_choices, parts))
    return tuple(chain(*choices)) if all(choices) else ()


def _default(config: Any, arguments: list[str]) -> dict[str, Any]:
    """Return tyro's argument for a configuration whose defaults depend on the command line."""
    return {"default": config.defaults(arguments)} if hasattr(config, "defaults") else {}


def _missing(error: ModuleNotFoundError, name: str, extra: str) -> Exception:
    """Return the error for a module that a command needs and this computer lacks."""
    if error.name in sys.stdlib_module_names:
        return RenetError(f"renet runs on Linux (on Windows in WSL 2): {error.name} is missing")
    if not error.name or error.name.startswith("renet"):
        return error
    return RenetError(f"`renet {name}` needs {error.name}: {install(extra)}")


def _match(arguments: list[str]) -> tuple[str, list[str]]:
    """Split arguments into the command's name, of one or two words, and its own arguments.

    For `renet evaluate --help` the name is the first word of several commands.
    """
    for words in (2, 1):
        name = " ".join(arguments[:words])
        if name in COMMANDS:
            return name, arguments[words:]
    first, *rest = arguments
    subcommands = [name for name in COMMANDS if name.startswith(f"{first} ")]
    if subcommands and (not rest or rest[0] in ("-h", "--help")):
        return first, rest
    if subcommands:
        seconds = [name.split()[1] for name in subcommands]
        raise unknown_name(f"command `renet {first}`", rest[0], seconds)
    raise unknown_name("command", first, {name.split()[0] for name in COMMANDS})


def _help(first: str) -> str:
    """Return the help: all commands by group, or those that begin with the word `first`."""
    lines = [f"renet {__version__}: quadruped locomotion that survives the loss of its camera"]
    width = max(map(len, COMMANDS))
    rows = [(n, c) for n, c in COMMANDS.items() if not first or n.split()[0] == first]
    for title, commands in groupby(rows, lambda row: row[1].group):
        lines += ["", title, *(f"  renet {name:<{width}}  {c.help}" for name, c in commands)]
    return "\n".join([*lines, "", "`renet COMMAND --help` shows every option with its default."])


def _print_completion(arguments: list[str]) -> int:
    """Print a script with which a shell completes the commands that can be imported here."""
    import tyro

    branches: dict[str, list[Any]] = {}
    for name, command in COMMANDS.items():
        *first, last = name.split()
        with suppress(ModuleNotFoundError):
            config = command.load([])[1]
            details = {"description": command.help, **_default(config, [])}
            branch = Annotated[config, tyro.conf.subcommand(last, **details)]
            branches.setdefault(" ".join(first), []).append(branch)
    top = branches.pop("")
    for name, commands in branches.items():
        group = Annotated[Union[tuple(commands)], tyro.conf.subcommand(name)]  # noqa: UP007
        top.append(group)
    every: Any = Union[tuple(top)]  # noqa: UP007
    with redirect_stdout(io.StringIO()) as script, suppress(SystemExit):
        tyro.cli(every, prog="renet", args=["--tyro-print-completion", *arguments])
    # In tyro's shell scripts each line of a description would become a choice.
    one_line = re.compile(r"^COMPLETION_SPEC.*$", re.MULTILINE)
    print(one_line.sub(lambda spec: spec[0].replace(r"\n", " "), script.getvalue()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
