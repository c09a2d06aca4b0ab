"""Sphinx's settings: `sphinx-build -W docs OUT`."""

import importlib.metadata
import re
from pathlib import Path

from renet.page.writer import VENDOR, PageCfg, write_page

project = "renet"
author = "the renet authors"
release = importlib.metadata.version("renet-locomotion")
extensions = [
    "myst_parser",
    "sphinx.ext.apidoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
html_theme = "furo"
html_title = f"renet {release}"
exclude_patterns = ["_build", "api/generated/modules.rst"]
myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence", "deflist"]
# Docstrings quote code in single backticks, as Markdown does.
default_role = "code"
apidoc_modules = [
    {
        "path": "../src/renet",
        "destination": "api/generated",
        "exclude_patterns": [
            "../src/renet/" + name
            for name in (
                "cli.py",
                "evaluation",
                "models",
                "page",
                "registry.py",
                "sim",
                "tasks",
                "training",
            )
        ],
        "max_depth": 3,
        "module_first": True,
        "automodule_options": {"members", "show-inheritance"},
    }
]
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_mock_imports = ["pybullet", "pybullet_utils", "pyrealsense2", "unitree_legged_sdk"]
# Diagrams are Mermaid's, which GitHub draws and Pygments does not know; packages offer again what
# their modules define.
suppress_warnings = ["misc.highlighting_failure", "ref.python"]

EMBEDDED = """```{raw} html
<iframe src="demo/" title="Break its camera" loading="lazy"
  style="width: 100%; height: 60rem; border: 0"></iframe>
<p><a href="demo/">Open it in a window of its own</a></p>
```"""


def setup(app) -> None:
    """Let links that lead somewhere on GitHub lead somewhere here, too; put the page inside."""
    app.connect("source-read", _mend_links)
    if all((PageCfg().runtime / name).is_file() for name in VENDOR):
        app.connect("source-read", _show_page)
        app.connect("build-finished", _write_page)


def _show_page(_app, name: str, source: list[str]) -> None:
    if name == "page":
        source[0] = source[0].replace("<!-- the page -->", EMBEDDED)


def _write_page(app, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        write_page(PageCfg(out=Path(app.outdir) / "demo"))


def _mend_links(_app, _name: str, source: list[str]) -> None:
    # The measurements' notes are a page of the site; a folder of the source is not.
    text = source[0].replace("(../benchmarks/NOTES.md", "(notes.md")
    source[0] = re.sub(r"\[([^\]]+)\]\((\.\./[^)#]+)\)", _file_or_words, text)


def _file_or_words(link: re.Match[str]) -> str:
    folder = (Path(__file__).parent / link[2]).is_dir()
    return link[1] if folder else link[0]
