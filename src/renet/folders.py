"""Folders that renet owns: written whole, exchanged at once, deleted entry by entry.

The caller lists a folder's entries: the names of regular files, relative to it. Anything else is
foreign: it is never overwritten or deleted.
"""

import ctypes
import errno
import fcntl
import os
import stat
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from renet.errors import RenetError, reason
from renet.files import is_temporary, sync, temporary_path, write_new

AT_FDCWD, RENAME_NOREPLACE, RENAME_EXCHANGE = -100, 1, 2
"""Constants of Linux, from <fcntl.h> and <linux/fs.h>."""
UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)
"""Errors of file systems that cannot exchange two names, such as NFS."""


def write_folder(
    path: Path, contents: Mapping[str, bytes], entries: Collection[str], what: str
) -> None:
    """Write a folder beside its final place and exchange it with what is there.

    A program that is killed leaves the folder as it was or as it is to be. Where the file system
    cannot exchange names, the folder is for a moment at `PATH.earlier-…` instead.

    Args:
        path: of the folder, which need not exist.
        contents: bytes of its files, by their names relative to it.
        entries: such names that the present folder may hold.
        what: the folder is, for messages, such as "bundle".

    Raises:
        RenetError: the present folder holds anything foreign, or it cannot be written.
    """
    path = path.resolve()  # "." has no name to rename.
    demand_own(path, entries, what)
    temporary = temporary_path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            for name, data in contents.items():
                file = temporary / name
                file.parent.mkdir(parents=True, exist_ok=True)
                write_new(file, data)
            sync(temporary)
            _exchange(temporary, path)
            sync(path.parent)
        finally:  # Half of the new folder, or the old one.
            remove_folder(temporary, {*contents, *entries})
    except OSError as error:
        raise RenetError(f"cannot write the {what} {path}: {reason(error)}") from error


def demand_own(path: Path, entries: Collection[str], what: str) -> None:
    """Raise RenetError unless nothing is at a path, or a folder without foreign entries."""
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise RenetError(f"{path} exists and is not a {what}: choose another folder")
    entry = foreign(path, entries)
    if entry is not None:
        raise RenetError(
            f"{path} holds {entry}, which is no part of a {what}: choose another folder"
        )


def foreign(folder: Path, entries: Collection[str]) -> str | None:
    """The first foreign entry of a folder, relative to it; None without any."""
    parents = {str(parent) for name in entries for parent in PurePosixPath(name).parents}
    folders = [folder] if folder.exists() else []
    try:
        while folders:  # Only those that may be there are entered: `folder` may be a whole disk.
            for path in sorted(folders.pop().iterdir()):
                name, mode = path.relative_to(folder).as_posix(), path.lstat().st_mode
                if stat.S_ISDIR(mode) and name in parents:
                    folders.append(path)
                elif not (stat.S_ISREG(mode) and (name in entries or is_temporary(path.name))):
                    return name
    except OSError as error:
        raise RenetError(f"cannot read the folder {folder}: {reason(error)}") from error
    return None


def remove_folder(folder: Path, entries: Collection[str]) -> None:
    """Delete a folder that holds its own entries alone, if there is one; one with others stays.

    Raises:
        RenetError: it holds a foreign entry, or cannot be deleted.
    """
    demand_own(folder, entries, "folder that renet may delete")
    try:
        for path in sorted(folder.rglob("*"), reverse=True):  # What a folder holds comes first.
            path.rmdir() if path.is_dir() else path.unlink()
        if folder.exists():
            folder.rmdir()
    except OSError as error:
        raise RenetError(f"cannot delete {folder}: {reason(error)}") from error


def new_folder(path: Path) -> Path:
    """Make a folder and its parents; raises OSError, such as FileExistsError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.mkdir()
    return path


def move(source: Path, target: Path) -> None:
    """Rename a file or folder; raises OSError where there is something at `target`."""
    try:
        _rename(source, target, RENAME_NOREPLACE)
    except OSError as error:
        if error.errno not in UNSUPPORTED or os.path.lexists(target):
            raise
        os.rename(source, target)


@contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Make a folder and keep other programs that lock it out; the kernel unlocks it at the end.

    Folders that it made, parents too, and that are still empty then are removed.

    Raises:
        RenetError: another program holds it, or it cannot be made.
    """
    try:
        made = [path for path in (folder, *folder.parents) if not path.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise RenetError(f"cannot write to {folder}: {reason(error)}") from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise RenetError(
                f"another program writes to {folder}: wait for it, or choose another folder"
            ) from error
        except OSError:
            pass  # A file system without locks.
        try:
            yield
        finally:
            with suppress(OSError):
                for path in made:
                    path.rmdir()
    finally:
        os.close(descriptor)


def _exchange(new: Path, final: Path) -> None:
    """Put one folder in another's place, at which nothing may be; the other is then at `new`."""
    if not final.exists():
        move(new, final)
        return
    try:
        _rename(new, final, RENAME_EXCHANGE)
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise
        earlier = final.with_name(f"{final.name}.earlier-{os.getpid()}")
        move(final, earlier)
        move(new, final)
        move(earlier, new)


def _rename(source: Path, target: Path, flags: int) -> None:
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if renameat2 is None:  # The C library is older than 2018.
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    if renameat2(AT_FDCWD, os.fsencode(source), AT_FDCWD, os.fsencode(target), flags):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), str(source), None, str(target))
