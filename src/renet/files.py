"""Reads files of unknown origin within stated limits; creates files without following links.

Every file that renet writes, renames or deletes goes through here or through `renet.folders`, which
`tools/writes.py` checks.
"""

import errno
import json
import os
import re
import secrets
import stat
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from renet.errors import RenetError, reason

MEGABYTE = 1_000_000
MAX_JSON = 4 * MEGABYTE
"""Bytes. Python objects need up to about 25 times the space of their JSON."""
MAX_DEPTH = 32
"""Deepest nesting of JSON values."""


def read_bytes(path: Path, limit: int, what: str = "file") -> bytes:
    """Read a whole file without ever waiting for another program.

    Args:
        path: of the file. limit: most bytes it may have.
        what: the file's name in messages, such as "manifest".

    Raises:
        RenetError: no such file, not a regular file (a folder, device, pipe or socket), larger
            than the limit, or unreadable.
    """
    try:
        # Without O_NONBLOCK, opening a named pipe waits for its writer.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            _check_regular(os.fstat(file.fileno()), path, limit, what)
            return file.read(limit)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path.
        raise RenetError(f"cannot read the {what} {path}: {reason(error)}") from error


def parse_json(data: bytes | str, what: str) -> Any:
    """Parse JSON; raises RenetError naming `what` if it is none or too deep."""
    try:
        value = json.loads(data)
    except RecursionError as error:
        raise RenetError(f"the {what} is nested deeper than {MAX_DEPTH} levels") from error
    except ValueError as error:
        raise RenetError(f"the {what} is not JSON: {error}") from error
    level = [value]
    for _ in range(MAX_DEPTH):
        level = [
            item
            for outer in level
            if isinstance(outer, dict | list)
            for item in (outer.values() if isinstance(outer, dict) else outer)
        ]
        if not level:
            return value
    raise RenetError(f"the {what} is nested deeper than {MAX_DEPTH} levels")


def read_object(path: Path, what: str = "file", limit: int = MAX_JSON) -> dict[str, Any]:
    """Read a JSON file that must hold an object.

    Args:
        path: of the file. what: its name in messages. limit: most bytes it may have.

    Raises:
        RenetError: as `read_bytes`; or not JSON, nested deeper than `MAX_DEPTH`, or no object.
    """
    value = parse_json(read_bytes(path, limit, what), f"{what} {path}")
    if not isinstance(value, dict):
        raise RenetError(f"the {what} {path} must hold a JSON object, not {type(value).__name__}")
    return value


def require_regular(path: Path, limit: int, what: str = "file") -> Path:
    """The path of a regular file within `limit` bytes, for libraries that open it themselves.

    Raises:
        RenetError: no such file, not a regular file, or larger than the limit.
    """
    try:
        _check_regular(path.stat(), path, limit, what)
    except (OSError, ValueError) as error:
        raise RenetError(f"cannot read the {what} {path}: {reason(error)}") from error
    return path


def _check_regular(status: os.stat_result, path: Path, limit: int, what: str) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise RenetError(f"the {what} {path} is not a regular file")
    if status.st_size > limit:
        raise RenetError(
            f"the {what} {path} has {status.st_size / MEGABYTE:.1f} MB; "
            f"at most {limit / MEGABYTE:g} MB are read"
        )


def create(path: Path, what: str = "file") -> BinaryIO:
    """Create a file for writing, and its folder.

    Raises:
        RenetError: there is something at `path`, be it a link, or it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return open(_new(path), "wb")
    except (OSError, ValueError) as error:
        raise RenetError(f"cannot write the {what} {path}: {reason(error)}") from error


def append(path: Path) -> TextIO:
    """Open a text file, by lines, at its end; raises OSError for links and what is no file."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    file = open(os.open(path, flags, 0o666), "a", newline="", buffering=1)  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return file


def write_atomically(path: Path, data: bytes, what: str = "file") -> None:
    """Write beside a file's final place, flush to the disk and rename; makes its folder.

    A link at `path` is replaced, not followed.

    Raises:
        RenetError: it cannot be written; what was at `path` is then unchanged.
    """
    try:
        temporary = temporary_path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            write_new(temporary, data)
            os.replace(temporary, path)
        finally:  # An interrupt, too, leaves nothing.
            temporary.unlink(missing_ok=True)
        sync(path.parent)
    except (OSError, ValueError) as error:
        raise RenetError(f"cannot write the {what} {path}: {reason(error)}") from error


def write_new(path: Path, data: bytes) -> None:
    """Write a file that must not exist yet and flush it to the disk; raises OSError."""
    with open(_new(path), "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def remove(path: Path) -> None:
    """Delete a file if there is one; raises RenetError where that cannot be done."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise RenetError(f"cannot delete {path}: {reason(error)}") from error


def temporary_path(path: Path) -> Path:
    """A hidden name beside a path that nobody can guess; `is_temporary` knows it."""
    return path.with_name(f".{path.name}.{secrets.token_hex(8)}.partial")


def is_temporary(name: str) -> bool:
    """Whether a file's or folder's name is one of `temporary_path`'s, left by a killed program."""
    return re.fullmatch(r"\..+\.[0-9a-f]{16}\.partial", name) is not None


def sync(folder: Path) -> None:
    """Flush a folder's list of entries to the disk, where its file system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _new(path: Path) -> int:
    """A descriptor of a file that did not exist; O_EXCL refuses links, too."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    return os.open(path, flags, 0o666)
