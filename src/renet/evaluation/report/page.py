"""Self-contained HTML pages from templates: everything inline, readable on a phone, no network."""

import base64
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from jinja2.exceptions import UndefinedError
from markupsafe import Markup

from renet.errors import RenetError
from renet.evaluation.figures import noise_label
from renet.evaluation.rollout import FLAT
from renet.faults import fault_class
from renet.files import read_bytes, write_atomically

MEDIA = {".png": ("image/png", 0, b"\x89PNG\r\n\x1a\n"), ".mp4": ("video/mp4", 4, b"ftyp")}
"""Media type of each kind of file, and the bytes by which it is known, with their place."""
MAX_MEDIA = 64_000_000
"""Bytes of a picture or film."""


class Section(NamedTuple):
    """A part of a page; one without a title follows the one before."""

    title: str
    html: Markup


def render(template: str, **context: Any) -> Section:
    """A section from a template, by its name without ".html" and its variables; text is escaped."""
    module = load_template(template).make_module(context)
    return Section(module.title, Markup(str(module)))  # type: ignore[attr-defined]


def study_sections(name: str, summary: dict[str, Any], folder: Path) -> list[Section]:
    """A study's template, from its summary and the figures in its folder, and the provenance."""
    with reading(f"{name} in {folder}"):
        section = render(name, summary=summary, settings=summary["settings"], folder=folder)
        macros: Any = load_template("macros").module
        return [section, Section("", Markup(macros.provenance(summary["provenance"])))]


@contextmanager
def reading(what: str) -> Iterator[None]:
    """Raise RenetError for whatever a summary lacks, or holds of another type."""
    try:
        yield
    except (UndefinedError, LookupError, TypeError, ValueError, AttributeError, OSError) as error:
        raise RenetError(
            f"the results of {what} are incomplete or damaged ({error}): run the study again"
        ) from error


def write_page(path: Path, title: str, lead: str, sections: Sequence[Section]) -> Path:
    """Write a page atomically; one of four sections or more begins with a list of them."""
    text = load_template("page").render(title=title, lead=lead, sections=sections)
    write_atomically(path, text.encode())
    return path


def data_uri(path: Path) -> str:
    """A PNG or mp4 as a data URI; raises RenetError for a link and for any other file."""
    refuse_link(path, path.parent)
    media, start, magic = MEDIA[path.suffix]
    content = read_bytes(path, MAX_MEDIA, "picture")
    if content[start : start + len(magic)] != magic:
        raise RenetError(f"{path} is no {path.suffix[1:].upper()} file: run the study again")
    return f"data:{media};base64,{base64.b64encode(content).decode()}"


def refuse_link(path: Path, folder: Path) -> None:
    """Raise RenetError where a link leads from a folder to a path inside it."""
    if path.resolve() != folder.resolve() / path.relative_to(folder):
        raise RenetError(f"{path} is a link: a report shows only what lies in {folder}")


def load_template(name: str) -> Template:
    """The template of a name."""
    return _environment().get_template(f"{name}.html")


@cache
def _environment() -> Environment:
    """Templates that escape what is put into them and refuse what is missing."""
    environment = Environment(
        loader=PackageLoader("renet.evaluation.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "crossed": crossed,
        "data_uri": data_uri,
        "fault_level": lambda run: fault_class(run["fault"]).describe(float(run["level"])),
        "measured": _measured,
        "noise": lambda run: noise_label(run.get("fault", "none"), run.get("level", 0.0)),
        "noise_rows": noise_rows,
        "words": lambda name: name.replace("_", " "),
    }
    return environment


def _measured(value: float | None, form: str, scale: float = 1.0, missing: str = "–") -> str:
    """A number as text, or what stands for one that was not measured."""
    return missing if value is None else form % (scale * value)


def crossed(run: dict[str, Any]) -> str:
    """How many robots of a fault study's row crossed; flat ground has no end."""
    share = run["measures"]["crossed"]["value"]
    return "-" if run["ground"] == FLAT else f"{share * run['robots']:.0f} of {run['robots']}"


def noise_rows(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of a noise study without noise, then by mode; only RENet's have a delay."""
    modes = summary["settings"]["modes"]
    rows = summary["baseline"] + [r for mode in modes for r in summary["runs"] if r["mode"] == mode]
    return [
        r | {"detection_delay_s": r.get("detection_delay_s") if r["mode"] == "memory" else None}
        for r in rows
    ]
