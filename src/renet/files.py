"""Reading of files of unknown origin within limits, and writing without following links.

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

from renet.errors import RenetError, obstacle

MEGABYTE = 1_000_000
MAX_JSON = 4 * MEGABYTE
"""Largest JSON file, bytes. Python objects need up to about 25 times the space of their JSON."""
MAX_DEPTH = 32
"""Deepest nesting of JSON values."""


def read_bytes(path: Path, limit: int, what: str = "file") -> bytes:
    """Read a whole file, without waiting for another program.

    Args:
        path: Path of the file.
        limit: Largest size, bytes.
        what: Kind of the file for messages, such as "manifest".

    Raises:
        RenetError: There is no such file, it is not a regular one (a folder, device, pipe or
            socket), it is larger than the limit, or it cannot be read.
    """
    try:
        # Without O_NONBLOCK, opening a named pipe waits for its writer.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            _check_regular(os.fstat(file.fileno()), path, limit, what)
            return file.read(limit)
    except (OSError, ValueError) as error:
        # A null byte in the path is a ValueError.
        raise RenetError(f"cannot read the {what} {path}: {obstacle(error, path)}") from error


def parse_json(data: bytes | str, what: str) -> Any:
    """Parse JSON.

    Args:
        data: The text.
        what: Description of it for messages, such as "manifest bundle.json".

    Raises:
        RenetError: The text is not JSON, or is nested deeper than `MAX_DEPTH`.
    """
    try:
        value = json.loads(data)
    except RecursionError as error:
        raise RenetError(f"the {what} is nested deeper than {MAX_DEPTH} levels") from error
    except ValueError as error:
        raise RenetError(f"the {what} is not JSON: {error}") from error
    # Descend level by level until none is left.
    level = [value]
    for _ in range(MAX_DEPTH):
        next_level: list[Any] = []
        for item in level:
            if isinstance(item, dict):
                next_level += item.values()
            elif isinstance(item, list):
                next_level += item
        if not next_level:
            return value
        level = next_level
    raise RenetError(f"the {what} is nested deeper than {MAX_DEPTH} levels")


def read_object(path: Path, what: str = "file", limit: int = MAX_JSON) -> dict[str, Any]:
    """Read a JSON file that must hold an object.

    Args:
        path: Path of the file.
        what: Kind of the file for messages.
        limit: Largest size, bytes.

    Raises:
        RenetError: The file cannot be read (see `read_bytes`), is not JSON, is nested deeper than
            `MAX_DEPTH`, or holds no object.
    """
    value = parse_json(read_bytes(path, limit, what), f"{what} {path}")
    if not isinstance(value, dict):
        raise RenetError(f"the {what} {path} must hold a JSON object, not {type(value).__name__}")
    return value


def require_regular(path: Path, limit: int, what: str = "file") -> Path:
    """Return a path for a library that opens it itself.

    Raises:
        RenetError: There is no such file, it is not a regular one, or it has more than `limit`
            bytes.
    """
    try:
        _check_regular(path.stat(), path, limit, what)
    except (OSError, ValueError) as error:
        raise RenetError(f"cannot read the {what} {path}: {obstacle(error, path)}") from error
    return path


def _check_regular(status: os.stat_result, path: Path, limit: int, what: str) -> None:
    """Raise RenetError unless a file is regular and has at most `limit` bytes."""
    if stat.S_ISDIR(status.st_mode):
        raise RenetError(f"the {what} {path} is not a regular file but a folder: give a file")
    if not stat.S_ISREG(status.st_mode):
        raise RenetError(f"the {what} {path} is not a regular file: give one")
    if status.st_size > limit:
        raise RenetError(
            f"the {what} {path} has {status.st_size / MEGABYTE:.1f} MB; "
            f"at most {limit / MEGABYTE:g} MB are read"
        )


def create(path: Path, what: str = "file") -> BinaryIO:
    """Create a file for writing, and its folder.

    Raises:
        RenetError: There is a file, folder or link at `path`, or it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return open(_new(path), "wb")
    except (OSError, ValueError) as error:
        raise RenetError(f"cannot write the {what} {path}: {obstacle(error, path)}") from error


def append(path: Path) -> TextIO:
    """Open a text file for appending lines; raises OSError for links and other irregular files."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    file = open(os.open(path, flags, 0o666), "a", newline="", buffering=1)  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "not a regular file", str(path))
    return file


def write_atomically(path: Path, data: bytes, what: str = "file") -> None:
    """Write a file beside its path, flush it to the disk, and rename it; creates its folder.

    A link at `path` is replaced, not followed.

    Raises:
        RenetError: The file cannot be written; an earlier file at `path` is then unchanged.
    """
    try:
        temporary = temporary_path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            write_new(temporary, data)
            os.replace(temporary, path)
        finally:
            # An interrupt leaves no file behind either.
            temporary.unlink(missing_ok=True)
        sync(path.parent)
    except (OSError, ValueError) as error:
        raise RenetError(f"cannot write the {what} {path}: {obstacle(error, path)}") from error


def write_new(path: Path, data: bytes) -> None:
    """Write a file that must not exist yet and flush it to the disk; raises OSError."""
    with open(_new(path), "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def remove(path: Path) -> None:
    """Delete a file if there is one; raises RenetError if it cannot be deleted."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise RenetError(f"cannot delete {path}: {obstacle(error, path)}") from error


def temporary_path(path: Path) -> Path:
    """Return a hidden path beside a path, with a random part that nobody can guess."""
    return path.with_name(f".{path.name}.{secrets.token_hex(8)}.partial")


def is_temporary(name: str) -> bool:
    """Return True for names of `temporary_path`, which killed programs leave behind."""
    return re.fullmatch(r"\..+\.[0-9a-f]{16}\.partial", name) is not None


def sync(folder: Path) -> None:
    """Flush a folder's list of entries to the disk, if its file system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _new(path: Path) -> int:
    """Create a file and return its descriptor; O_EXCL refuses existing files and links."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    return os.open(path, flags, 0o666)
