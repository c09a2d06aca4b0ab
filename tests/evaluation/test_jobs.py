"""Several processes and several shards make what one run makes."""

import json
import multiprocessing
import os
import re
import shutil
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

from renet import cli, terminal
from renet.errors import RenetError
from renet.evaluation import jobs
from renet.evaluation.studies.faults import FaultStudy
from renet.evaluation.studies.memory import MemoryStudy

from .counting import CountingEvaluator, CountingStudy, end_at_start, end_when_ready

pytestmark = pytest.mark.wall_clock

TOLD = r"parts [0-5]/5  [a-e]  [0-3]/3  [0-9-]+:[0-9-]{2}:[0-9-]{2} left"
"""Line of progress in a file."""


@pytest.fixture
def started() -> Callable[[], set[BaseProcess]]:
    """Processes that the test has started, and that have not ended."""
    others = {*multiprocessing.active_children()}
    return lambda: {*multiprocessing.active_children()} - others


def results(folder: Path) -> dict:
    """A summary without date and command."""
    summary = json.loads((folder / "summary.json").read_text())
    assert summary.pop("provenance")["seed"] == 1
    assert summary["settings"].pop("out")
    return summary


def made(folder: Path) -> dict[str, dict]:
    return {p.name[0]: json.loads(p.read_text()) for p in (folder / "parts").glob("?-*.json")}


def test_jobs_share_parts_and_processors_and_write_what_one_run_writes(
    tmp_path, capsys, monkeypatch, started
):
    one, two = (CountingStudy(tmp_path / name, jobs=n) for name, n in (("one", 1), ("two", 2)))
    one.main()
    monkeypatch.setattr(terminal, "LINE_EVERY", 0.0)
    two.main()
    assert results(tmp_path / "one") == results(tmp_path / "two")
    assert not {"jobs", "shard"} & results(tmp_path / "two")["settings"].keys()
    parts = made(tmp_path / "two")
    assert list(sorted(parts)) == ["a", "b", "c", "d", "e"]
    assert os.getpid() not in {part["process"] for part in parts.values()}
    assert {part["process"] for part in made(tmp_path / "one").values()} == {os.getpid()}
    cpus = {part["process"]: set(part["cpus"]) for part in parts.values()}
    assert set.union(*cpus.values()) <= os.sched_getaffinity(0)
    if len(cpus) == 2 <= len(os.sched_getaffinity(0)):
        assert not set.intersection(*cpus.values())
    lines = capsys.readouterr().err.splitlines()
    assert [line for line in lines if not re.fullmatch(TOLD, line)] == []
    assert lines
    two.main()
    assert made(tmp_path / "two") == parts, "what had finished was made again"
    assert not started()


def test_shards_whose_parts_are_put_together_write_what_one_run_writes(tmp_path, capsys):
    CountingStudy(tmp_path / "one").main()
    first, second = (CountingStudy(tmp_path / n, shard=f"{n}/2") for n in "12")
    first.main()
    assert set(made(first.out)) == {"a", "c", "e"}
    assert not (first.out / "summary.json").exists()
    assert "shard 1/2 is made; 2 of 5 parts are missing" in capsys.readouterr().out
    second.main()
    assert set(made(second.out)) == {"b", "d"}
    shutil.copytree(second.out / "parts", first.out / "parts", dirs_exist_ok=True)
    parts = made(first.out)
    replace(first, shard=None).main()
    assert made(first.out) == parts, "what had finished was made again"
    assert results(first.out) == results(tmp_path / "one")
    replace(second, out=tmp_path / "same").main()
    replace(first, out=tmp_path / "same").main()
    assert results(tmp_path / "same") == results(tmp_path / "one")


@pytest.mark.parametrize(
    ("fate", "error", "message"),
    [
        ("refused", RenetError, "^b is refused$"),
        ("broken", RuntimeError, "(?s)^b failed.*ValueError: b is broken"),
        ("killed", RenetError, "made b ended with code 9; if memory was short, give fewer --jobs"),
    ],
)
def test_an_error_in_one_part_ends_all_jobs_and_keeps_the_other_parts(
    tmp_path, started, fate, error, message
):
    study = CountingStudy(tmp_path, letters="ab", fate=fate, jobs=2)
    with pytest.raises(error, match=message):
        study.run()
    assert not started()
    assert not (tmp_path / "summary.json").exists()
    assert len(replace(study, fate="").run()["runs"]) == 2


@pytest.mark.parametrize("work", [end_at_start, end_when_ready])
def test_a_process_that_is_killed_before_it_reads_is_told_in_a_line(
    tmp_path, monkeypatch, started, work
):
    monkeypatch.setattr(jobs, "_work", work)
    with pytest.raises(RenetError, match="ended with code 9; if memory was short, give fewer"):
        CountingStudy(tmp_path, letters="ab", jobs=2).run()
    assert not started()


def test_a_process_that_is_killed_before_its_parts_are_sent_is_told_in_a_line(
    tmp_path, monkeypatch, started
):
    receive = jobs._receive

    def receive_and_kill(job: jobs.Job) -> jobs.ProgressMessage | None:
        message = receive(job)
        if message is None:
            job.process.kill()
            job.process.join()
        return message

    monkeypatch.setattr(jobs, "_receive", receive_and_kill)
    with pytest.raises(RenetError, match=r"made [ab] ended with code -9; if memory was short"):
        CountingStudy(tmp_path, letters="ab", jobs=2).run()
    assert not started()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_all_jobs_in_one_line(tmp_path, monkeypatch, capfd, started, number):
    command = cli.Command("", f"{CountingStudy.__module__}:CountingStudy:CountingStudy.main")
    command = replace(command, resume=cli.KEPT)
    monkeypatch.setitem(cli.COMMANDS, "evaluate counting", command)

    def interrupt() -> None:
        while not (tmp_path / "begun").exists():
            time.sleep(0.05)
        children = [child.pid or 0 for child in started()]
        # A terminal sends it to all of them.
        for process in (children if number == signal.SIGINT else []) + [os.getpid()]:
            os.kill(process, number)

    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    thread = threading.Thread(target=interrupt, daemon=True)
    thread.start()
    options = ["--letters", "ab", "--fate", "endless", "--jobs", "2", "--out", str(tmp_path)]
    try:
        assert cli.main(["evaluate", "counting", *options]) == 130
    finally:
        for n, handler in zip((signal.SIGINT, signal.SIGTERM), before, strict=True):
            signal.signal(n, handler)
    thread.join()
    assert not started()
    said = capfd.readouterr().err
    assert said.splitlines()[-1] == f"renet: interrupted: {cli.KEPT}"
    assert "Traceback" not in said
    assert not list(tmp_path.rglob("*.partial"))


def test_numbers_of_jobs_and_shards_that_make_no_sense_are_refused(tmp_path):
    for shard in ("0/2", "3/2", "1", "a/b", "1/2/3", "-1/2"):
        with pytest.raises(RenetError, match="write I/N, such as 1/2 and 2/2"):
            CountingStudy(tmp_path, shard=shard)
    with pytest.raises(RenetError, match="jobs must be at least 1"):
        MemoryStudy(tmp_path, jobs=0)
    with pytest.raises(RenetError, match="override make_evaluator"):
        CountingStudy(tmp_path, jobs=2).run(CountingEvaluator())  # type: ignore[arg-type]

    class Local(CountingStudy):
        pass

    with pytest.raises(RenetError, match="--jobs needs a study that other processes can import"):
        Local(tmp_path, jobs=2).run()


def test_robots_that_retire_and_jobs_and_shards_change_no_digit_of_a_study(tmp_path, monkeypatch):
    options = {"faults": ("blackout:5", "frozen:5"), "grounds": ("gap",), "level": 6, "robots": 2}
    options |= {"onsets": (0.5,), "lasts": 2.0, "seconds": 7.0, "healthy_minutes": 0.0}
    options |= {"conditions": "nominal"}
    with monkeypatch.context() as patch:
        patch.setattr(FaultStudy, "retires", False)
        FaultStudy(tmp_path / "whole", **options).run()
    whole = results(tmp_path / "whole")
    assert 0 < sum(run["falls"] for run in whole["runs"]) < sum(r["robots"] for r in whole["runs"])
    first = FaultStudy(tmp_path / "parts", **options, shard="1/3")
    first.main()
    assert not (tmp_path / "parts" / "summary.json").exists()
    replace(first, jobs=2, shard=None).main()
    assert results(tmp_path / "parts") == whole
