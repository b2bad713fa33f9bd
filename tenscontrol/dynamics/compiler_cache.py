"""Compiled libraries kept from one run to the next, in a folder of the user's own.

A library is code that runs with the rights of the user, so nothing is loaded
that another user may have written.
"""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path

from tenscontrol.dynamics.compiler import VARIABLE, Compiler, suffix

_DIGITS = 32  # of each hash in a file name: 128 bits


@dataclass(frozen=True)
class Cache:
    """A folder of libraries.

    A library's name is the key of what it was made from, then the hash of its
    own content: that shows whether the file is whole, and one file needs no
    second one beside it that could be out of step.

    Attributes
    ----------
    folder : Path
    temporary : bool
        Whether the folder goes when the process ends.
    """

    folder: Path
    temporary: bool

    def find(self, key: str) -> Path | None:
        """Return the library of a key, or None. One that is not whole is removed.

        Raises
        ------
        PermissionError
            If another user may have written it.
        """
        for path in sorted(self.folder.glob(f"{key}-*{suffix()}")):
            _refuse_unsafe(path, "file", "remove it")
            if path == self._place(key, path.read_bytes()):
                return path
            path.unlink(missing_ok=True)
        return None

    def add(self, key: str, library: Path) -> Path:
        """Move a library that was made in :meth:`workshop` to its place, at one blow."""
        library.chmod(0o700)
        place = self._place(key, library.read_bytes())
        # Another process may have been first; then it is the same file.
        if not place.exists():
            os.replace(library, place)
        return place

    def workshop(self) -> tempfile.TemporaryDirectory[str]:
        """Return a private folder to compile in, on the same file system."""
        return tempfile.TemporaryDirectory(dir=self.folder, prefix="making-")

    def _place(self, key: str, content: bytes) -> Path:
        return self.folder / f"{key}-{sha256(content).hexdigest()[:_DIGITS]}{suffix()}"


def open_cache() -> Cache:
    """Return the cache of the user, or a temporary one where that cannot be written.

    Raises
    ------
    PermissionError
        If another user may write into the folder.
    """
    folder = _user_folder()
    if folder is None:
        return _temporary()
    try:
        with suppress(FileExistsError):  # of something that is no folder: told below
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return _temporary()
    _refuse_unsafe(
        folder, "folder", "put it right (chmod 700), or set XDG_CACHE_HOME to another folder"
    )
    return Cache(folder, False) if os.access(folder, os.W_OK | os.X_OK) else _temporary()


def key_of(source: str, compiler: Compiler, *others: object) -> str:
    """Return the hash of all that a library depends on."""
    text = "\0".join([source, *compiler.command, compiler.version, *map(str, others)])
    return sha256(text.encode()).hexdigest()[:_DIGITS]


def _user_folder() -> Path | None:
    """Return where the system wants the cache, or None if the user has no home."""
    given = os.getenv("XDG_CACHE_HOME", "")
    if Path(given).is_absolute():  # the specification says to ignore a relative one
        return Path(given) / "tenscontrol"
    if os.name == "nt":
        local = os.getenv("LOCALAPPDATA", "")
        return Path(local) / "tenscontrol" if Path(local).is_absolute() else None
    try:
        home = Path.home()
    except RuntimeError:
        return None
    return home / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "tenscontrol"


def _temporary() -> Cache:
    return Cache(Path(_temporary_folder().name), temporary=True)


@cache
def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    """Return one private folder for the process, removed at its end."""
    # Windows does not remove a library in use.
    return tempfile.TemporaryDirectory(prefix="tenscontrol-", ignore_cleanup_errors=True)


def _refuse_unsafe(path: Path, kind: str, remedy: str) -> None:
    """Refuse a folder or file that somebody else may have written."""
    found = path.lstat()  # of the link itself, if it is one
    is_kind = stat.S_ISDIR if kind == "folder" else stat.S_ISREG
    fault = ""
    if not is_kind(found.st_mode):
        fault = f"is no {kind}" + (", but a link" if stat.S_ISLNK(found.st_mode) else "")
    elif os.name != "nt":  # there, others have no access to the profile of a user
        if found.st_uid != os.geteuid():
            fault = f"belongs to user {found.st_uid}, expected {os.geteuid()}, who runs this"
        elif found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            fault = f"has mode {stat.S_IMODE(found.st_mode):03o}: other users may write to it"
    if fault:
        raise PermissionError(
            f"compiled code is not loaded from {path}, which {fault}. "
            f"Find out why and {remedy}, or set {VARIABLE}=none to do without a compiler"
        )
