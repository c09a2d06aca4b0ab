"""The code's version names the commit of renet's own clone, and of no other repository."""

import re
import subprocess
import tomllib
from pathlib import Path

from renet import __version__, version


def test_an_edited_clone_is_told_from_a_clean_and_an_installed_one(tmp_path, monkeypatch):
    monkeypatch.setattr(version, "CHECKOUT", tmp_path / "inside")
    (tmp_path / "inside").mkdir()
    (tmp_path / "file").write_text("1")
    git = ["git", "-C", str(tmp_path), "-c", "user.name=x", "-c", "user.email=x"]
    for command in (["init", "-q"], ["add", "file"], ["commit", "-q", "-m", "x"]):
        subprocess.run([*git, *command], check=True)
    assert version.code_version() == __version__

    monkeypatch.setattr(version, "CHECKOUT", tmp_path)
    assert re.fullmatch(rf"{__version__} \([0-9a-f]{{12}}\)", version.code_version())
    (tmp_path / "file").write_text("2")
    assert str(version.commit()).endswith("+changed")


def test_packages_and_the_build_are_pinned():
    project = Path(__file__).parents[1]
    build = tomllib.loads((project / "pyproject.toml").read_text())["build-system"]["requires"]
    locks = [file.read_text().splitlines() for file in project.rglob("requirements-lock.txt")]
    for names in (build, *locks):
        assert [name for name in names if not re.fullmatch(r"#.*|[\w.-]+==[\w.+]+", name)] == []
        assert any("==" in name for name in names)
