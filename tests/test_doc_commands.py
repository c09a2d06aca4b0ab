"""Commands and links in the documents: each parses, each leads somewhere."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import tyro

from renet import cli

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"(<!-- not run:[^\n]*\n)?```(?:bash|console)\n(.*?)```", re.DOTALL)


def commands(page: Path) -> list[str]:
    """The lines `renet …` of a page's blocks, and those of the tables of the README."""
    text = page.read_text()
    lines = [
        line for marker, block in BLOCK.findall(text) if not marker for line in block.split("\n")
    ]
    return [line.lstrip("$ ") for line in lines if line.lstrip("$ ").startswith("renet ")]


COMMANDS = sorted({line for page in PAGES for line in commands(page) if "…" not in line})


@pytest.mark.parametrize("line", COMMANDS)
def test_command_of_the_documents_parses(line: str):
    for part in line.split("&& "):
        _, *arguments = shlex.split(part, comments=True)
        name, rest = cli._match(arguments)
        _, config, rest = cli.COMMANDS[name].load(rest)
        if "--help" in rest:
            continue
        # A run to go on from is looked for on the disk: its settings are those of any other.
        settings = [part for part in rest if part not in ("--resume", "latest")]
        given = {"default": config.defaults(settings)} if hasattr(config, "defaults") else {}
        tyro.cli(config, args=rest, **given)


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and MyST make them."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    words = [re.sub(r"[^\w\- ]", "", re.sub(r"\[([^]]+)\]\([^)]*\)", r"\1", h)) for h in headings]
    return {word.strip().lower().replace(" ", "-") for word in words}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_and_anchor_leads_somewhere(page: Path):
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", page.read_text()):
        if "://" in target:
            continue
        other = (page.parent / target).resolve() if target else page
        assert other.exists(), target
        if anchor and other.suffix == ".md":
            assert anchor in anchors(other), f"{target}#{anchor}"
