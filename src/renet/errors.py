"""Exception for errors that a user can correct, and its messages."""

import errno
import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from pathlib import Path


class RenetError(Exception):
    """Error that a user can correct. The message names the cause and what to do about it.

    The command line prints it as one line and exits with code 2.
    """


class Problems(RenetError):
    """Several errors that a user can correct, in one message."""

    def __init__(self, problems: Sequence[str]) -> None:
        numbered = (f"({number}) {problem}" for number, problem in enumerate(problems, 1))
        super().__init__(f"{len(problems)} things are in the way: {'; '.join(numbered)}")
        self.problems = list(problems)
        """A line for each error."""


def demand_none(problems: Sequence[str]) -> None:
    """Raise RenetError with all problems, if there are any."""
    if len(problems) == 1:
        raise RenetError(problems[0])
    if problems:
        raise Problems(problems)


@contextmanager
def collected(problems: list[str]) -> Iterator[None]:
    """Context that adds the errors raised in it to a list of problems."""
    try:
        yield
    except Problems as error:
        problems += error.problems
    except RenetError as error:
        problems.append(str(error))


def reason(error: Exception) -> str:
    """Return an error's message, without the number and path that the system's errors contain."""
    return getattr(error, "strerror", None) or str(error)


def obstacle(error: Exception, path: Path) -> str:
    """Return the reason why a path cannot be read or written, and the way out."""
    return f"{reason(error)}: {_way_out(error, path)}"


def _way_out(error: Exception, path: Path) -> str:
    """Return the instruction for an error of the system, or of a path that cannot exist."""
    match getattr(error, "errno", None):
        case errno.ENOENT:
            return _nearest_path(path)
        case errno.EEXIST | errno.ENOTDIR:
            return _file_on_the_way(path)
        case errno.EISDIR:
            return "give a file, not a folder"
        case errno.EACCES | errno.EPERM | errno.EROFS:
            return "change its permissions, or give another path"
        case errno.ENOSPC | errno.EDQUOT:
            return "free the disk, or give another path"
        case errno.ENAMETOOLONG:
            return "give a shorter path"
    return "give another path"


def _nearest_path(path: Path) -> str:
    """Return the question whether a path that exists, and is named like a missing one, is meant."""
    for missing in reversed((path, *path.parents)):
        if not os.path.lexists(missing):
            siblings: list[str] = []
            with suppress(OSError):
                siblings = [sibling.name for sibling in missing.parent.iterdir()]
            nearest = get_close_matches(missing.name, siblings, n=1, cutoff=0.7)
            if nearest:
                return f"did you mean {missing.with_name(nearest[0])}?"
            return "give the path of one that exists"
    return "give the path of one that exists"


def _file_on_the_way(path: Path) -> str:
    """Return the instruction for a path on which a file is where a folder should be."""
    for part in (path, *path.parents):
        # Unlike a path's own methods, these raise no error of the system.
        if os.path.exists(part) and not os.path.isdir(part):
            return f"{part} is a file; give another path"
    return "give another path"


def printable(text: str) -> str:
    """Return a text, which may come from a stranger, without characters that control a terminal."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def install(extra: str) -> str:
    """Return the instruction to install an extra of `pyproject.toml`."""
    # From a clone, because renet is not on PyPI.
    extras = f"[{extra}]" if extra else ""
    return f"in a clone of renet, run pip install -c requirements-lock.txt -e '.{extras}'"


def demand_name(kind: str, name: str, choices: Collection[str]) -> None:
    """Raise `unknown_name` unless a name is among the choices."""
    if name not in choices:
        raise unknown_name(kind, name, choices)


def unknown_name(kind: str, name: str, choices: Iterable[str]) -> RenetError:
    """Build the error for a name that is not among the choices.

    Its message suggests the most similar names, or lists all of them.

    Args:
        kind: Kind of the name, such as "fault".
        name: Name that the user wrote.
        choices: Names that exist.
    """
    names = list(choices)
    nearest = get_close_matches(name, names, cutoff=0.7)
    hint = f"choose one of {', '.join(names)}"
    if nearest:
        hint = f"did you mean {' or '.join(nearest)}?"
    return RenetError(f"unknown {kind} {name[:40]!r}: {hint}")
