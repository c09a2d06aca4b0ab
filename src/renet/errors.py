"""The exception that renet raises for everything a user can correct."""

from collections.abc import Collection, Iterable
from difflib import get_close_matches


class RenetError(Exception):
    """Bad input or a bad file: the message names what is wrong and what to do about it.

    The command line prints it as one line and exits with code 2.
    """


def printable(text: str) -> str:
    """One line of a text that may be a stranger's: nothing in it commands the terminal."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def install(extra: str) -> str:
    """How to install what an extra of `pyproject.toml` lists; renet is not on PyPI."""
    extras = f"[{extra}]" if extra else ""
    return f"in a clone of renet, run pip install -c requirements-lock.txt -e '.{extras}'"


def demand_name(kind: str, name: str, choices: Collection[str]) -> None:
    """Raise `unknown_name` unless a name is among the choices."""
    if name not in choices:
        raise unknown_name(kind, name, choices)


def unknown_name(kind: str, name: str, choices: Iterable[str]) -> RenetError:
    """The error for a name that is not among the choices: it suggests the nearest, or lists all.

    Args:
        kind: what the name stands for, such as "fault". name: what the user wrote.
        choices: the names that exist.
    """
    names = list(choices)
    nearest = get_close_matches(name, names, cutoff=0.7)
    hint = f"choose one of {', '.join(names)}"
    if nearest:
        hint = f"did you mean {' or '.join(nearest)}?"
    return RenetError(f"unknown {kind} {name[:40]!r}: {hint}")
