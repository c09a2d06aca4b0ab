"""Documents: commands run here or say what they take; links, files, tests and layers exist."""

import pydoc
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from renet import cli

ROOT = Path(__file__).parents[1]
ARCHITECTURE = (ROOT / "docs" / "how_it_works.md").read_text()
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
PROGRAM = re.compile(r"(nohup )?(renet|python \w+/\w+\.py) ")
WALKS = re.findall(r"```text\n(.*?)```", ARCHITECTURE, re.DOTALL)
"""Ways through the code: a file on each line that begins with one."""
QUICK = "renet bundle inspect"
"""The command that is run here; test_cli.py runs every command's --help."""
EXAMPLES = (ROOT / "tests" / "test_examples.py").read_text()


def commands(page: Path) -> list[tuple[str, str, str]]:
    """Each command of a page's blocks with the comment beside it and the last one above it."""
    rows = []
    for block in re.findall(r"```(?:bash|console)\n(.*?)```", page.read_text(), re.DOTALL):
        above = ""
        for line in block.replace("\\\n", "").splitlines():
            command, _, comment = (part.strip() for part in line.partition("#"))
            if not command:
                above = comment
            elif PROGRAM.match(f"{command} "):
                rows.append((command, comment, above))
    return rows


COMMANDS = sorted({(page.name, *row) for page in PAGES for row in commands(page)})
INLINE = re.findall(r"`(renet [^`…]+)`", (ROOT / "README.md").read_text())
LINES = sorted({line for _, line, *_ in COMMANDS} | {*INLINE})


@pytest.mark.parametrize(("page", "line", "comment", "above"), COMMANDS)
def test_command_runs_in_a_test_or_says_what_it_takes(page, line, comment, above):
    script = re.match(r"python examples/(\w+)\.py", line)
    tested = line == QUICK or line.endswith("--help") or (script and f'"{script[1]}"' in EXAMPLES)
    assert tested or any(re.match("takes |needs ", said) for said in (comment, above)), page


def test_the_quick_command_runs(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(shlex.split(QUICK)[1:]) == 0
    assert len(capsys.readouterr().out.splitlines()) > 20


def parse(arguments: list[str]):
    """The settings of a command line without `renet`; None where it asks for help."""
    name, rest = cli._match(arguments)
    _, config, rest = cli.COMMANDS[name].load(rest)
    if "--help" in rest:
        return None
    # A run to go on from is looked for on the disk: its settings are those of any other.
    settings = shlex.split(re.sub(r"--resume \S+", "", shlex.join(rest)))
    return cli.parse(config, settings, "")


@pytest.mark.parametrize("line", [x for x in LINES if re.match("renet (?!COMMAND)", x)])
def test_command_of_the_documents_parses(line):
    for part in line.split("&& "):
        parse(shlex.split(part)[1:])


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and MyST make them."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    words = [re.sub(r"[^\w\- ]", "", re.sub(r"\[([^]]+)\]\([^)]*\)", r"\1", h)) for h in headings]
    return {word.strip().lower().replace(" ", "-") for word in words}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_anchor_and_path_of_the_repository_leads_somewhere(page):
    for target, anchor in re.findall(r"\]\(([^)#\s]*)#?([^)\s]*)\)", page.read_text()):
        if "://" in target:
            continue
        other = (page.parent / target).resolve() if target else page
        assert other.exists(), target
        if anchor and other.suffix == ".md":
            assert anchor in anchors(other), f"{target}#{anchor}"
    parts = "src|web|docs|tests|tools|benchmarks|examples"
    paths = re.findall(rf"`((?:{parts})/[\w./-]*)`", page.read_text())
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_names_of_the_api_page_and_files_of_the_papers_parts_exist():
    page = (ROOT / "docs" / "api" / "index.md").read_text()
    names = re.findall(r"(?:`|:: )(renet\.[\w.]+)", page)
    files = re.findall(r"`([a-z0-9_/]+/[a-z0-9_]+\.py)`", ARCHITECTURE.split("## The paper")[1])
    assert len(names) > 20
    assert len(set(files)) > 25
    assert [name for name in names if pydoc.locate(name) is None] == []
    assert [file for file in files if not (ROOT / "src" / "renet" / file).is_file()] == []


def test_every_threat_is_met_by_tests_that_exist():
    notes = (ROOT / "benchmarks" / "NOTES.md").read_text()
    table = notes.split("### Which tests meet which threat?")[1].split("### ")[0]
    rows = re.findall(r"^\| (?!threat)(.+?) \| (`.+) \|$", table, re.MULTILINE)
    assert len(rows) > 15
    for threat, tests in rows:
        files = re.findall(r"`([^`]+\.py)`", tests)
        missing = [file for file in files if not (ROOT / "tests" / file).is_file()]
        assert files, threat
        assert not missing, threat


def test_tests_that_closed_findings_exist():
    """Each as `file::function`, at least one for most findings."""
    notes = (ROOT / "benchmarks" / "NOTES.md").read_text()
    named = re.findall(r"`([\w/]+\.py)::(test_\w+)`", notes)
    missing = []
    for path, name in named:
        if not re.search(rf"^def {name}\(", (ROOT / path).read_text(), re.MULTILINE):
            missing.append(f"{path}::{name}")
    assert missing == []
    assert len(named) > 60


@pytest.mark.parametrize("walk", WALKS)
def test_files_of_a_way_through_the_code_exist_and_are_few(walk):
    files = re.findall(r"^((?:src|benchmarks|tools)/\S+)", walk, re.MULTILINE)
    missing = [file for file in files if not (ROOT / file).exists()]
    assert not missing
    assert 3 <= len(files) <= 5


def test_the_layers_are_those_that_ci_checks():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = contracts["contracts"][0]["layers"]
    section = ARCHITECTURE.split("## Packages")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`.*?) \|", section, re.MULTILINE)
    names = [re.findall(r"`(\w+)`", row) for row in rows]
    assert names == [re.findall(r"renet\.(\w+)", layer) for layer in layers]
    packages = {path.parent.name for path in (ROOT / "src" / "renet").glob("*/__init__.py")}
    assert packages <= {name for row in names for name in row}
