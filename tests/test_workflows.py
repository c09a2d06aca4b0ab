"""GitHub's workflows: every command that they run exists here, and a release has its notes."""

import os
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml

import renet

ROOT = Path(__file__).parents[1]
WORKFLOWS = {
    path.stem: yaml.safe_load(path.read_text()) for path in ROOT.glob(".github/workflows/*.yml")
}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def steps(workflow: str) -> list[dict]:
    jobs = WORKFLOWS[workflow]["jobs"].values()
    return [step for job in jobs for step in job["steps"]]


@pytest.mark.parametrize("name", WORKFLOWS)
def test_a_workflow_starts_ends_and_names_what_exists(name):
    workflow = WORKFLOWS[name]
    assert workflow[True], "YAML reads the key `on` as true"
    assert workflow["permissions"] == {"contents": "read"}, "what writes says so in its own job"
    jobs = workflow["jobs"]
    for job in jobs.values():
        assert job["runs-on"]
        assert {job["needs"]} <= jobs.keys() if "needs" in job else True
    for step in steps(name):
        assert ("uses" in step) != ("run" in step)
        command = step.get("run", "")
        for path in re.findall(r"(?:^|\s)((?:\.ci|tools|docs)/[\w./-]+)", command):
            assert (ROOT / path).exists(), path
        for extras in re.findall(r"'\.\[([\w,]+)\]'", command):
            assert {*extras.split(",")} <= PROJECT["optional-dependencies"].keys()


@pytest.mark.parametrize("name", WORKFLOWS)
def test_actions_are_pinned_by_their_commit_and_named_by_their_version(name):
    """A tag can be moved to other code."""
    text = (ROOT / f".github/workflows/{name}.yml").read_text()
    used = [line.split("uses:")[1].strip() for line in text.splitlines() if "uses:" in line]
    assert used
    for action in used:
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}  # (v\d+\.\d+\.\d+|release/v1)", action)


def test_a_release_installs_nothing_without_a_hash():
    for step in steps("release"):
        for command in re.findall(r"pip install (.*)", step.get("run", "")):
            assert "--require-hashes" in command or "--no-deps" in command
    pinned = (ROOT / ".github/requirements-release.txt").read_text().splitlines()[2:]
    lock = dict(
        line.lower().replace("_", "-").split("==")
        for line in (ROOT / "requirements-lock.txt").read_text().splitlines()
        if "==" in line
    )
    for line in pinned:
        name, version = re.fullmatch(
            r"([\w.-]+)==([\w.]+) --hash=sha256:[0-9a-f]{64}", line
        ).groups()
        assert lock.get(name.lower(), version) == version, name
    needed = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["sim"]]
    names = {line.split("==")[0].lower() for line in pinned}
    assert {re.split("[=~><]", need)[0].lower() for need in needed} <= names


def test_checks_run_what_ci_runs_and_all_versions_of_python():
    assert any(step.get("run") == ".ci/run" for step in steps("ci"))
    versions = {"3.11", *WORKFLOWS["ci"]["jobs"]["python"]["strategy"]["matrix"]["python-version"]}
    low, high = re.findall(r"3\.(\d+)", PROJECT["requires-python"])
    assert versions == {f"3.{minor}" for minor in range(int(low), int(high))}


@pytest.mark.parametrize(("tag", "code"), [(f"v{renet.__version__}", 0), ("v9.9.9", 1)])
def test_a_release_has_the_notes_of_its_version_or_stops(tmp_path, tag, code):
    script = next(step["run"] for step in steps("release") if "notes" in step.get("name", ""))
    (tmp_path / "CHANGELOG.md").write_text((ROOT / "CHANGELOG.md").read_text())
    environment = {**os.environ, "GITHUB_REF_NAME": tag}
    command = ["bash", "-e", "-c", script]
    assert subprocess.run(command, cwd=tmp_path, env=environment).returncode == code
    notes = (tmp_path / "notes.md").read_text()
    assert bool(notes.strip()) == (code == 0)
    assert "## [" not in notes


def test_hooks_before_a_commit_are_checks_of_ci():
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())
    checks = (ROOT / ".ci" / "run").read_text()
    for hook in config["repos"][0]["hooks"]:
        assert hook["entry"].removesuffix(" --force-exclude") in checks
