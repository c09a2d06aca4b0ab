"""Sphinx's settings: `sphinx-build -W docs OUT`."""

import importlib.metadata
import os
import re
from pathlib import Path

from renet.page.writer import VENDOR, PageCfg, write_page

project = "renet"
author = "the renet developers"
copyright = f"2026 {author}, Apache-2.0"
release = importlib.metadata.version("renet-locomotion")
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"renet {release}"
exclude_patterns = ["_build"]
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "deflist"]
# Docstrings quote code in single backticks, as Markdown does.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "description"
# Optional extras, of which the documentation needs only the docstrings.
autodoc_mock_imports = ["pybullet", "pyrealsense2", "scipy", "unitree_legged_sdk"]
# Packages offer again what their modules define.
suppress_warnings = ["ref.python"]

EMBEDDED = """## The page, live

```{raw} html
<iframe src="demo/" title="Break its camera" loading="lazy"
  style="width: 100%; height: 60rem; border: 0"></iframe>
<p><a href="demo/">Open it in a window of its own</a></p>
```"""

COLAB = (
    " [![Open in Colab](https://colab.research.google.com/assets/colab-badge.svg)]"
    "(https://colab.research.google.com/github/{}/blob/main/examples/walk.ipynb)"
)


def setup(app) -> None:
    """Let links that lead somewhere on GitHub lead somewhere here, too; put the page inside."""
    app.connect("source-read", _mend_links)
    if all((PageCfg().runtime / name).is_file() for name in VENDOR):
        app.connect("source-read", _show_page)
        app.connect("build-finished", _write_page)


def _show_page(_app, name: str, source: list[str]) -> None:
    if name == "start":
        source[0] = source[0].replace("<!-- the page -->", EMBEDDED)


def _write_page(app, error: Exception | None) -> None:
    if error is None and app.builder.format == "html":
        write_page(PageCfg(out=Path(app.outdir) / "demo"))


def _mend_links(_app, _name: str, source: list[str]) -> None:
    # The measurements' notes are a page of the site; a folder of the source is not.
    text = source[0].replace("(../benchmarks/NOTES.md", "(notes.md")
    if repository := os.environ.get("GITHUB_REPOSITORY"):
        text = text.replace("<!-- colab -->", COLAB.format(repository))
    source[0] = re.sub(r"\[([^\]]+)\]\((\.\./[^)#]+)\)", _file_or_words, text)


def _file_or_words(link: re.Match[str]) -> str:
    target = Path(__file__).parent / link[2]
    if target.suffix == ".md":  # No page of the site, but a file to download.
        return f"{{download}}`{link[1]} <{link[2]}>`"
    return link[1] if target.is_dir() else link[0]
