"""Self-contained HTML pages: everything inline, light and dark, readable on a phone, no network."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from renet.evaluation.results import Provenance, write_text

STYLE = """
:root { color-scheme: light dark; --ink: #1d2127; --soft: #5b6470; --paper: #fbfbfa; --card: #fff;
  --line: #e3e6ea; --good: #2e7d4f; --bad: #b3382c; --accent: #3c3ca0; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ee; --soft: #9aa4b1; --paper: #14171b;
  --card: #1c2026; --line: #2d333b; --good: #7ac796; --bad: #f08a7e; --accent: #a5a8f5; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.6 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 60rem; margin: 0 auto; padding: 2rem 1.1rem 4rem; }
h1 { font-size: clamp(1.5rem, 5vw, 2.2rem); line-height: 1.2; margin: 0 0 .5rem; }
h2 { font-size: 1.25rem; margin: 2.5rem 0 .5rem; }
p.lead { font-size: 1.1rem; color: var(--soft); margin-top: 0; }
figure { margin: 1.2rem 0; }
figure img, figure video { display: block; width: 100%; height: auto; background: #fff; }
figure img { min-width: 34rem; }
figure video { border-radius: 8px; }
figcaption { color: var(--soft); font-size: .9rem; margin-top: .4rem; }
.scroll { overflow-x: auto; border: 1px solid var(--line); border-radius: 8px;
  background: var(--card); }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums;
  font-size: .92rem; }
th, td { padding: .45rem .8rem; text-align: right; border-bottom: 1px solid var(--line);
  white-space: nowrap; }
th { color: var(--soft); font-weight: 600; }
tr:last-child td { border-bottom: 0; }
th.text, td.text { text-align: left; }
td.text { white-space: normal; min-width: 7rem; }
td.good { color: var(--good); font-weight: 600; }
td.bad { color: var(--bad); font-weight: 600; }
nav { margin: 1.2rem 0; }
nav a { display: inline-block; margin: 0 1.1rem .3rem 0; }
a { color: var(--accent); }
details { margin: 1rem 0; }
summary { cursor: pointer; color: var(--soft); padding: .3rem 0; }
@media (prefers-color-scheme: dark) { figure img.plot { filter: invert(.89) hue-rotate(180deg); }
  figure img.photo { filter: brightness(.85); } }
.facts { display: grid; gap: .8rem; grid-template-columns: repeat(auto-fit, minmax(10rem, 1fr));
  margin: 1.4rem 0; }
.fact { background: var(--card); border: 1px solid var(--line); border-radius: 8px;
  padding: .8rem 1rem; }
.fact b { display: block; font-size: 1.5rem; line-height: 1.3; color: var(--accent); }
.fact span { color: var(--soft); font-size: .88rem; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .2rem 1rem; font-size: .85rem; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; font-family: ui-monospace,
  SFMono-Regular, Menlo, monospace; }
"""

MIME = {".png": "image/png", ".mp4": "video/mp4"}


@dataclass(frozen=True)
class Cell:
    """A table cell that is coloured: `tone` is "good" or "bad"."""

    text: str
    tone: str


@dataclass
class Page:
    """A page, written from top to bottom by its methods."""

    title: str
    lead: str
    _parts: list[str] = field(default_factory=list)
    _headings: list[str] = field(default_factory=list)

    def heading(self, text: str) -> None:
        """A section's heading; a page of four or more gets a list of them."""
        self._headings.append(text)
        self._parts.append(f'<h2 id="part-{len(self._headings)}">{escape(text)}</h2>')

    def text(self, text: str) -> None:
        """A paragraph of plain text."""
        self._parts.append(f"<p>{escape(text)}</p>")

    def facts(self, facts: Sequence[tuple[str, str]]) -> None:
        """Large numbers: (value, what it is)."""
        cards = (
            f'<div class="fact"><b>{escape(value)}</b><span>{escape(what)}</span></div>'
            for value, what in facts
        )
        self._parts.append(f'<div class="facts">{"".join(cards)}</div>')

    def table(
        self,
        header: Sequence[str],
        rows: Sequence[Sequence[Any]],
        text: int = 1,
        folded: str = "",
    ) -> None:
        """A table; its first `text` columns hold words, the others numbers.

        With `folded` it is a line of that text until the reader opens it.
        """
        kind = [' class="text"' if i < text else "" for i in range(len(header))]
        head = "".join(f"<th{k}>{escape(h)}</th>" for k, h in zip(kind, header, strict=True))
        body = "".join(
            "<tr>" + "".join(_cell(c, k) for k, c in zip(kind, row, strict=True)) + "</tr>"
            for row in rows
        )
        table = (
            f'<div class="scroll" tabindex="0"><table><thead><tr>{head}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>"
        )
        fold = f"<details><summary>{escape(folded)}</summary>{table}</details>"
        self._parts.append(fold if folded else table)

    def picture(self, path: Path, caption: str, photo: bool = False) -> None:
        """A PNG, put inside the page; a dark page turns it dark unless it is a photo."""
        kind = "photo" if photo else "plot"
        self._parts.append(
            f'<figure><div class="scroll" tabindex="0"><img class="{kind}" src="{data_uri(path)}"'
            f' alt="{escape(caption, quote=True)}"></div>'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
        )

    def video(self, path: Path, caption: str) -> None:
        """An mp4, put inside the page."""
        self._parts.append(
            f'<figure><video controls loop muted autoplay playsinline src="{data_uri(path)}">'
            f"</video><figcaption>{escape(caption)}</figcaption></figure>"
        )

    def provenance(self, provenance: Provenance | Mapping[str, Any]) -> None:
        """Where the numbers come from."""
        facts = provenance if isinstance(provenance, Mapping) else vars(provenance)
        items = "".join(
            f"<dt>{escape(name.replace('_', ' '))}</dt><dd>{escape(str(value))}</dd>"
            for name, value in facts.items()
        )
        self._parts.append(f"<dl>{items}</dl>")

    def html(self) -> str:
        """The whole page."""
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{escape(self.title)}</title><style>{STYLE}</style></head><body><main>"
            f'<h1>{escape(self.title)}</h1><p class="lead">{escape(self.lead)}</p>'
            + self._contents()
            + "\n".join(self._parts)
            + "</main></body></html>\n"
        )

    def _contents(self) -> str:
        """Links to the headings, or nothing where there are few."""
        if len(self._headings) < 4:
            return ""
        links = (
            f'<a href="#part-{number}">{escape(text)}</a>'
            for number, text in enumerate(self._headings, start=1)
        )
        return f"<nav>{' '.join(links)}</nav>"

    def write(self, path: Path) -> Path:
        """Write the page, atomically."""
        write_text(path, self.html())
        return path


def _cell(content: Any, kind: str) -> str:
    """One table cell."""
    if isinstance(content, Cell):
        return f'<td class="{content.tone}">{escape(content.text)}</td>'
    return f"<td{kind}>{escape(str(content))}</td>"


def data_uri(path: Path) -> str:
    """A PNG or mp4 as a data URI."""
    content = base64.b64encode(path.read_bytes()).decode()
    return f"data:{MIME[path.suffix]};base64,{content}"
