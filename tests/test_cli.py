"""The door: every command explains itself, and every mistake is one line and exit code 2."""

import os
import re
import runpy
import shutil
import signal
import subprocess
import sys
from contextlib import nullcontext, suppress
from pathlib import Path

import pytest

from renet import cli
from renet.deploy.cfg import DeployCfg
from renet.evaluation.demo import DemoStudy
from renet.evaluation.results import Provenance
from renet.terminal import progress

(STATE,) = Path(cli.__file__).parent.glob("pretrained/checkpoint/*/state.json")


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    try:
        code = cli.main(list(arguments))
    except SystemExit as stop:
        code = int(stop.code or 0)
    return code, *capsys.readouterr()


def test_help_lists_every_command_within_80_columns_or_those_of_one_word(capsys):
    code, out, _ = run(capsys, "--help")
    assert (code, [name for name in cli.COMMANDS if f"renet {name}" not in out]) == (0, [])
    assert max(map(len, out.splitlines())) <= 80
    groups = list(dict.fromkeys(command.group for command in cli.COMMANDS.values()))
    assert [line for line in out.splitlines() if line in groups] == groups
    code, out, _ = run(capsys, "bundle")
    assert (code, "renet bundle card" in out, "renet train" in out) == (0, True, False)


HELP = """
import contextlib, io, sys
from renet import cli
for name in sys.argv[1:]:
    with contextlib.redirect_stdout(io.StringIO()) as out:
        try:
            cli.main([*name.split(), "--help"])
        except SystemExit as stop:
            assert stop.code == 0, name
    assert "--" in out.getvalue(), name
    heavy = {"torch", "mjlab", "warp", "mediapy"} & {*sys.modules}
    assert not heavy, (name, heavy)
"""


def test_every_command_has_help_that_imports_neither_torch_nor_mjlab():
    commands = [*cli.COMMANDS, "train Renet-Go1-Parkour --num-envs 8"]
    subprocess.run([sys.executable, "-c", HELP, *commands], check=True)


@pytest.mark.parametrize("backend", ["nonsense", "osmesa"])
def test_a_backend_of_opengl_that_does_not_load_ends_no_command(backend, tmp_path):
    walk = [sys.executable, "-m", "renet", "deploy", "--camera", "sim", "--seconds", "0.1"]
    walk += ["--out", str(tmp_path / "walk")]
    environment = os.environ | {"MUJOCO_GL": backend}
    done = subprocess.run(walk, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_help_of_a_task_fits_a_screen_and_says_where_the_rest_is(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for arguments in (["train", "--help"], ["train", "Renet-Go1-Parkour", "--help"]):
        _, out, _ = run(capsys, *arguments)
        assert len(out.splitlines()) <= 50
        assert max(map(len, out.splitlines())) <= 80
        named = "num-envs seed max-iterations resume time-budget log-root device engine"
        named += " config scene help-all"
        assert [name for name in named.split() if f"--{name}" not in out] == []


def test_a_bar_keeps_share_and_time_left_at_80_columns(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    title = "12/29 intermittent_blackout on stairs_down, 280 robots"
    assert list(progress(range(3), title)) == [0, 1, 2]
    plain = re.sub(r"\x1b\[[?\d;]*[A-Za-z]", "", capsys.readouterr().err)
    bar = plain.splitlines()[-1].split("\r")[-1]
    assert re.fullmatch(rf"{title} .*100% 0:00:00 *", bar)
    assert len(bar) <= 80


@pytest.mark.parametrize("module", ["renet", "renet.cli"])
def test_it_runs_as_a_module(module):
    command = [sys.executable, "-m", module, "--version"]
    assert subprocess.check_output(command, text=True).strip() == cli.__version__


COMPLETE = """
source /dev/stdin
for line in "renet de" "renet evaluate fau" "renet deploy --terrain st"; do
    COMP_WORDS=($line) COMP_CWORD=$((${#COMP_WORDS[@]} - 1)) COMPREPLY=()
    _tyro_renet && echo "${COMPREPLY[@]}"
done
"""


def test_the_shell_completes_commands_options_and_choices(capsys):
    _, script, _ = run(capsys, "--print-completion", "bash")
    out = subprocess.check_output(["bash", "-c", COMPLETE], input=script, text=True)
    assert out.splitlines() == ["demo deploy", "faults", "stairs stairs_up stairs_down"]


@pytest.mark.parametrize("words", [["--bundle", "b"], ["--bundle=b"], ["b"]])
def test_a_bundle_may_be_named_where_it_is_positional(words):
    for place in (0, 2):
        arguments = ["--seed", "4"]
        arguments[place:place] = words
        assert cli.parse(DeployCfg, arguments, "renet deploy").bundle == Path("b")
    study = cli.parse(DemoStudy, ["--bundle", "b"], "renet demo")
    assert study.bundle == Path("b"), "a study's has a name"


def test_a_bundle_without_a_value_is_left_to_the_parser(capsys):
    with pytest.raises(SystemExit, match="2"):
        cli.parse(DeployCfg, ["--bundle"], "renet deploy")
    assert "--bundle" in capsys.readouterr().err


@pytest.mark.parametrize(("rank", "says"), [("0", "wait\n"), ("1", "")])
def test_a_slow_command_speaks_at_once_and_once_for_all_ranks(capsys, monkeypatch, rank, says):
    monkeypatch.setenv("RANK", rank)
    slow = cli.Command("", "", options="renet.options:ExportCfg", beginning="wait")
    slow.check(["run"], "renet export")
    assert capsys.readouterr().out == says
    slow.check(["--help"], "renet export")
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, 0])
def test_an_interrupt_that_an_import_turns_into_an_error_is_one(capsys, monkeypatch, number):
    """As native modules do."""
    # Under nohup the tests ignore it.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

    def load(*arguments):
        with suppress(KeyboardInterrupt):
            os.kill(os.getpid(), number)
        raise ImportError("initialization failed")

    monkeypatch.setattr(cli.Command, "load", load)
    with nullcontext() if number else pytest.raises(ImportError):
        assert run(capsys, "deploy") == (130, "", "renet: interrupted\n")


def test_a_full_disk_behind_standard_output_is_one_line():
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-m", "renet"], stdout=full, stderr=subprocess.PIPE)
    assert (done.returncode, done.stderr) == (2, b"renet: No space left on device\n")


def test_results_of_python_m_renet_name_the_command_renet(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/a/renet/__main__.py", "--version"])
    with pytest.raises(SystemExit):
        runpy.run_module("renet", run_name="__main__")
    assert Provenance("", "", "", 1).command == "renet --version"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("termios", "renet runs on Linux (on Windows in WSL 2): termios is missing"),
        ("mujoco", "`renet deploy` needs mujoco: in a clone of renet, run pip install"),
    ],
)
def test_a_missing_module_is_named_with_what_to_do(capsys, monkeypatch, name, message):
    monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(cli.Command, "load", lambda *_: __import__(name))
    code, _, err = run(capsys, "deploy")
    assert (code, err.count("\n"), message in err) == (2, 1, True), err


def test_a_damaged_checkpoint_is_named(capsys, tmp_path):
    folder = tmp_path / "it_00000001"
    folder.mkdir()
    shutil.copy(STATE, folder)
    (folder / "model.safetensors").write_bytes(b"not tensors")
    code, _, err = run(capsys, "export", str(tmp_path), "--out", str(tmp_path / "bundle"))
    assert (code, "incomplete or damaged" in err) == (2, True)
    assert not (tmp_path / "bundle").exists()


@pytest.mark.parametrize("arguments", [["--help"], ["evaluate", "log", "--help"], ["nonsense"]])
def test_a_reader_that_leaves_ends_it_quietly(arguments):
    # Unbuffered, the first line already meets the closed pipe; buffered, the last flush does.
    for unbuffered in ([], ["-u"]):
        command = [sys.executable, *unbuffered, "-m", "renet", *arguments]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        process.stdout.close()
        _, errors = process.communicate(timeout=60)
        if arguments == ["nonsense"]:
            assert (process.returncode, errors.count(b"\n")) == (2, 1)
        else:
            assert (process.returncode in (1, cli.SIGPIPE_CODE), errors) == (True, b"")


def test_a_closed_standard_output_ends_in_no_traceback():
    command = f"{sys.executable} -m renet bundle inspect >&-"
    done = subprocess.run(["bash", "-c", command], stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (0, "")
