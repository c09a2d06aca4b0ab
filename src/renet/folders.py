"""Folders that renet owns: they are written whole, exchanged at once, and deleted by entries.

Callers list the entries of a folder, which are the names of regular files relative to it. All other
files in it are foreign: they are never overwritten or deleted.
"""

import ctypes
import errno
import fcntl
import os
import stat
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from renet.errors import RenetError, obstacle
from renet.files import is_temporary, sync, temporary_path, write_new

# Constants of Linux, from <fcntl.h> and <linux/fs.h>.
AT_FDCWD = -100
RENAME_NOREPLACE = 1
RENAME_EXCHANGE = 2
UNSUPPORTED = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)
"""Errors of file systems that cannot exchange two names, such as NFS."""


def write_folder(
    path: Path, contents: Mapping[str, bytes], entries: Collection[str], what: str
) -> None:
    """Write a folder beside its path, and exchange it with the present one.

    A program that is killed leaves either the old or the new folder. If the file system cannot
    exchange names, the old folder is at `PATH.earlier-…` for a moment.

    Args:
        path: Path of the folder, which need not exist.
        contents: Bytes of its files, by their names relative to it.
        entries: Names that the present folder may hold.
        what: Kind of the folder for messages, such as "bundle".

    Raises:
        RenetError: The present folder holds a foreign entry, or cannot be written.
    """
    # The folder "." has no name that could be exchanged.
    path = path.resolve()
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
        finally:
            # This is the old folder, or after an error part of the new one.
            remove_folder(temporary, {*contents, *entries})
    except OSError as error:
        raise RenetError(f"cannot write the {what} {path}: {obstacle(error, path)}") from error


def demand_own(path: Path, entries: Collection[str], what: str) -> None:
    """Raise RenetError unless a path does not exist, or is a folder without foreign entries."""
    if path.is_symlink() or (path.exists() and not path.is_dir()):
        raise RenetError(f"{path} exists and is not a {what}: choose another folder")
    entry = foreign(path, entries)
    if entry is not None:
        raise RenetError(
            f"{path} holds {entry}, which is no part of a {what}: choose another folder"
        )


def foreign(folder: Path, entries: Collection[str]) -> str | None:
    """Return the first foreign entry of a folder, relative to it; None if there is none."""
    parents: set[str] = set()
    for name in entries:
        parents.update(map(str, PurePosixPath(name).parents))
    folders = [folder] if folder.exists() else []
    try:
        # Only parents of entries are searched, because `folder` may be a whole disk.
        while folders:
            for path in sorted(folders.pop().iterdir()):
                name = path.relative_to(folder).as_posix()
                mode = path.lstat().st_mode
                if stat.S_ISDIR(mode) and name in parents:
                    folders.append(path)
                elif not (stat.S_ISREG(mode) and (name in entries or is_temporary(path.name))):
                    return name
    except OSError as error:
        raise RenetError(f"cannot read the folder {folder}: {obstacle(error, folder)}") from error
    return None


def remove_folder(folder: Path, entries: Collection[str]) -> None:
    """Delete a folder without foreign entries, if it exists.

    Raises:
        RenetError: The folder holds a foreign entry, and stays, or it cannot be deleted.
    """
    demand_own(folder, entries, "folder that renet may delete")
    try:
        # In reverse order the contents of a folder come before the folder.
        for path in sorted(folder.rglob("*"), reverse=True):
            if path.is_dir():
                path.rmdir()
            else:
                path.unlink()
        if folder.exists():
            folder.rmdir()
    except OSError as error:
        raise RenetError(f"cannot delete {folder}: {obstacle(error, folder)}") from error


def new_folder(path: Path) -> Path:
    """Create a folder and its parents; raises OSError, such as FileExistsError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.mkdir()
    return path


def move(source: Path, target: Path) -> None:
    """Rename a file or folder; raises OSError if `target` exists."""
    try:
        _rename(source, target, RENAME_NOREPLACE)
    except OSError as error:
        if error.errno not in UNSUPPORTED or os.path.lexists(target):
            raise
        os.rename(source, target)


@contextmanager
def lock(folder: Path) -> Iterator[None]:
    """Context in which no other program can lock a folder, which is created.

    Folders that it creates, also parents, are removed at the end if they are still empty.

    Raises:
        RenetError: Another program has locked the folder, or it cannot be created.
    """
    try:
        made = [path for path in (folder, *folder.parents) if not path.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise RenetError(f"cannot write to {folder}: {obstacle(error, folder)}") from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise RenetError(
                f"another program writes to {folder}: wait for it, or choose another folder"
            ) from error
        except OSError:
            # The file system has no locks.
            pass
        try:
            yield
        finally:
            with suppress(OSError):
                for path in made:
                    path.rmdir()
    finally:
        os.close(descriptor)


def _exchange(new: Path, final: Path) -> None:
    """Exchange two folders; if there is none at `final`, move the new one there."""
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
    """Rename by Linux's `renameat2`; raises OSError."""
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    # C libraries before 2018 lack it.
    if renameat2 is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    if renameat2(AT_FDCWD, os.fsencode(source), AT_FDCWD, os.fsencode(target), flags):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), str(source), None, str(target))
