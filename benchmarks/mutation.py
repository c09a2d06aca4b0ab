"""How many small changes of what decides over the robot the tests notice (mutmut).

For each part: makes all mutants of its modules, takes a seeded sample, and runs for each of them
the mirrored tests that reach the mutated function. Works in `mutants/PART`; started again, it goes
on where it was interrupted, as long as the sources are the same.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import tyro

from facts import errors_in_one_line, report
from renet.errors import RenetError, demand_name

ROOT = Path(__file__).parents[1]
PARTS = {
    "files": (["files.py", "folders.py"], ["tests/test_files.py", "tests/test_folders.py"]),
    "models": (["bundle/graph.py"], ["tests/bundle/test_graph.py"]),
    "selector": (["selector/*.py"], ["tests/selector"]),
    "pilot": (["pilot/*.py"], ["tests/pilot", "tests/deploy/test_inference.py"]),
    "gate": (
        ["selector/monitors.py"],
        ["tests/selector/test_monitors.py", "tests/selector/test_memory.py"],
    ),
    "calibration": (
        ["selector/calibration.py"],
        [f"tests/selector/test_{name}.py" for name in ("calibration", "selector")],
    ),
    "np3o": (
        ["training/np3o.py"],
        [
            "tests/training/test_np3o.py",
            "tests/training/test_precision.py::test_policy_update_never_waits",
        ],
    ),
    "safety": (
        [f"deploy/safety/{name}.py" for name in ("checks", "limits", "machine")],
        ["tests/deploy/safety/test_safety.py"],
    ),
    "controller": (
        ["deploy/controller.py"],
        [f"tests/deploy/test_{name}.py" for name in ("controller", "inference", "loop")],
    ),
    "envelope": (["deploy/robots/envelope.py"], ["tests/deploy/robots/test_envelope.py"]),
    "go1": (
        ["deploy/robots/go1/link.py"],
        [f"tests/deploy/robots/{name}.py" for name in ("go1/test_driver", "real/test_braking")],
    ),
    "go2": (
        ["deploy/dds/messages.py"]
        + [f"deploy/robots/go2/{name}.py" for name in ("link", "messages")],
        ["tests/deploy/dds/test_messages.py", "tests/deploy/robots/real/test_braking.py"]
        + [f"tests/deploy/robots/go2/test_{name}.py" for name in ("link", "messages")],
    ),
    "sender": (
        [f"deploy/robots/real/{name}.py" for name in ("braking", "mailbox", "sender")],
        [f"tests/deploy/robots/real/test_{name}.py" for name in ("braking", "mailbox", "sender")],
    ),
}
"""Modules to mutate, within src/renet, and the tests that mirror them."""
ALIVE, KILLED = (0, 33), (1, 3)
"""mutmut's exit codes: no test failed or none reaches it; a test failed. Others: it never ended."""

PATIENCE = 600.0
"""Seconds that a mutant's tests may take on a busy computer, beside 15 times what they took."""


@dataclass(frozen=True)
class Cfg:
    json: Path | None = None
    """File for the results; parts that it holds already are kept."""
    sample: int = 40
    """Mutants of each part."""
    seed: int = 1
    parts: tuple[str, ...] = tuple(PARTS)
    only: tuple[str, ...] = ()
    """Run these mutants of the one part instead, as the results name them."""
    again: bool = False
    """Run the survivors in `json` again, with the tests written for them; keeps the first score."""
    skip: str = ""
    """Tests to leave out, as pytest's -k names them: fewer tests, a lower score."""


def prepare(part: str, skip: str) -> Path:
    """A folder in which mutmut mutates one part, and runs its tests from a server of processes.

    Torch does not survive the fork of a process that has used it.
    """
    folder = ROOT / "mutants" / part
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("src", "tests"):
        shutil.copytree(ROOT / name, folder / name, dirs_exist_ok=True)
    modules, tests = PARTS[part]
    settings = {
        "source_paths": ["src"],
        "only_mutate": [f"src/renet/{module}" for module in modules],
        "pytest_add_cli_args_test_selection": tests,
        "pytest_add_cli_args": ["-n", "0", *(["-k", f"not ({skip})"] if skip else [])],
        "process_isolation": "forkserver",
        "timeout_constant": PATIENCE / 15.0,
    }
    lines = [f"{name} = {json.dumps(value)}" for name, value in settings.items()]
    text = (ROOT / "pyproject.toml").read_text() + "\n[tool.mutmut]\n" + "\n".join(lines) + "\n"
    (folder / "pyproject.toml").write_text(text)
    return folder


def mutmut(folder: Path, *names: str) -> dict[str, int | None]:
    """Run mutants by name, one after the other; returns the exit code of all there are.

    Without a name all are made and the tests timed, before mutmut complains that nothing matches.
    """
    environment = os.environ | {"CI": "1", "OMP_NUM_THREADS": "1"}  # CI: no deadlines in tests.
    command = ["mutmut", "run", "--max-children", "1", *(names or ["none"])]
    subprocess.run(command, cwd=folder, check=bool(names), env=environment)
    files = sorted((folder / "mutants").rglob("*.meta"))
    metas = [json.loads(file.read_text())["exit_code_by_key"] for file in files]
    return {name: code for codes in metas for name, code in codes.items()}


def draw(folder: Path, part: str, cfg: Cfg) -> dict[str, Any]:
    """Result of a sample of a part's mutants."""
    codes = mutmut(folder)
    names = sorted(codes)
    chosen = random.Random(f"{cfg.seed} {part}").sample(names, min(cfg.sample, len(names)))
    rest = [name for name in chosen if codes[name] is None]
    codes = mutmut(folder, *rest) if rest else codes
    alive = sorted(name for name in chosen if codes[name] in ALIVE)
    return {
        "mutants": len(names),
        "run": len(chosen),
        "seed": cfg.seed,
        "score": round(1.0 - len(alive) / len(chosen), 3),
        "ended_by_time": sum(codes[name] not in (*ALIVE, *KILLED) for name in chosen),
        "tests_left_out": cfg.skip,
        "alive": alive,
        "date": date.today().isoformat(),
    }


def run_again(folder: Path, result: dict[str, Any], cfg: Cfg) -> dict[str, Any]:
    """Outcome of a result's survivors with the tests of today; the others were noticed before."""
    codes = mutmut(folder, *result["alive"])
    alive = [name for name in result["alive"] if codes[name] in ALIVE]
    return {
        "score": round(1.0 - len(alive) / result["run"], 3),
        "tests_left_out": cfg.skip,
        "alive": alive,
        "date": date.today().isoformat(),
    }


def main(cfg: Cfg) -> None:
    """Run the parts, and write the results after each.

    Raises:
        RenetError: There is no such part, or no result of it to run again.
    """
    results = json.loads(cfg.json.read_text()) if cfg.json and cfg.json.exists() else {}
    for part in cfg.parts:
        demand_name("part", part, PARTS)
        if cfg.again and part not in results:
            raise RenetError(f"there is no result of {part} to run again: name its file by --json")
    for part in cfg.parts:
        folder = prepare(part, cfg.skip)
        if cfg.only:
            codes = mutmut(folder, *cfg.only)
            print({name: codes[name] for name in cfg.only})
            continue
        if not cfg.again:
            results[part] = draw(folder, part, cfg)
        elif results[part]["alive"]:
            results[part]["again"] = run_again(folder, results[part], cfg)
        report({name: results[name] for name in PARTS if name in results}, cfg.json)


if __name__ == "__main__":
    with errors_in_one_line():
        main(tyro.cli(Cfg))
