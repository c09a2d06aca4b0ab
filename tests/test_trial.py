"""A trial's verdict names the true reason: processor time, memory, a wait, a crash."""

from pathlib import Path

import pytest

from renet import trial
from renet.errors import RenetError
from renet.trial import run_trial

MODULE = """
import ctypes, os, sys, time
from renet.trial import judge

def spin(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass

judge(lambda: eval(sys.argv[1]) or "")
"""


@pytest.fixture
def attempt(tmp_path: Path, monkeypatch):
    """Runs an expression as a trial."""
    (tmp_path / "a_trial.py").write_text(MODULE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    monkeypatch.setattr(trial, "STALL_INTERVAL", 0.5)
    return lambda code, data=b"": run_trial("a_trial", [code], "the model", data)


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("'it has no head'", "the model: it has no head"),
        ("os.write(1, b'accepted') and 'a library prints'", "the model: a library prints"),
        ("spin(60)", "more than 3 s of processor time"),
        ("bytearray(1 << 30)", "more than 400 MB of memory"),
        ("time.sleep(600)", "it did nothing for"),
        ("os.mkfifo(sys.argv[0] + 'p') or open(sys.argv[0] + 'p')", "it did nothing for"),
        ("ctypes.string_at(0)", "it crashes"),
        ("os._exit(3)", "it crashes"),
        ("os.write(os.open('/tmp/written', os.O_CREAT | os.O_WRONLY), b'x')", "it crashes"),
    ],
)
def test_the_reason_is_named(attempt, code, reason):
    with pytest.raises(RenetError, match=reason):
        attempt(code)


def test_a_trial_may_last_as_long_as_the_computer_is_busy(attempt):
    """Four times its patience, in which it ran."""
    attempt("spin(2.0)")


def test_a_trial_that_waits_for_a_processor_does_something(attempt, monkeypatch):
    seconds = iter(range(1, 100))
    monkeypatch.setattr(trial, "_active_seconds", lambda pid: next(seconds))
    attempt("time.sleep(2.0)")


def test_data_arrive_whole(attempt):
    with pytest.raises(RenetError, match="20000000"):
        attempt("spin(1.0) or str(len(sys.stdin.buffer.read()))", bytes(20_000_000))
