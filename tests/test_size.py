"""The lines that features added, in tools/additions.json, are those of git's history."""

import json
import subprocess

import pytest

from size import ADDITIONS, CODE, ROOT


def git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_what_each_commit_of_a_feature_added_is_what_git_counts():
    commits = {
        name: lines
        for feature in json.loads(ADDITIONS.read_text()).values()
        for name, lines in feature.items()
    }
    try:
        log = git("show", "--numstat", "--no-renames", "--format=commit %H", *commits)
    except subprocess.CalledProcessError:
        pytest.skip("this clone lacks the history")
    for part in log.split("commit ")[1:]:
        name, *rows = part.splitlines()
        files = [row.split("\t") for row in rows if row.endswith(tuple(CODE))]
        added = [
            sum(int(new) - int(old) for new, old, path in files if path.startswith(f"{folder}/"))
            for folder in ("src", "tests")
        ]
        assert commits[name[:7]] == added, name
