"""The exception that renet raises for everything a user can correct."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches


class RenetError(Exception):
    """Bad input or a bad file: the message names what is wrong and what to do about it.

    The command line prints it as one line and exits with code 2.
    """


class Problems(RenetError):
    """Several things that a user can correct, all told at once."""

    def __init__(self, problems: Sequence[str]) -> None:
        numbered = (f"({number}) {problem}" for number, problem in enumerate(problems, 1))
        super().__init__(f"{len(problems)} things are in the way: {'; '.join(numbered)}")
        self.problems = list(problems)
        """One line for each."""


def demand_none(problems: Sequence[str]) -> None:
    """Raise RenetError with all problems, if there are any."""
    if len(problems) == 1:
        raise RenetError(problems[0])
    if problems:
        raise Problems(problems)


@contextmanager
def collected(problems: list[str]) -> Iterator[None]:
    """Add what is wrong in the block to a list of problems."""
    try:
        yield
    except Problems as error:
        problems += error.problems
    except RenetError as error:
        problems.append(str(error))


def reason(error: Exception) -> str:
    """What went wrong, without the number and the path that the system's errors bring along."""
    return getattr(error, "strerror", None) or str(error)


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
