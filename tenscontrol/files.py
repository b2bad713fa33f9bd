"""Files read, and written whole: all that was meant for one, or what it held before."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# What to do about an error of the file system, by its number; else only writing elsewhere helps.
_REMEDY = {
    errno.EEXIST: "give another name, or remove what is there",
    errno.EISDIR: "give the name of a file: this is a folder",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.ENOENT: "make its folder first",
    errno.ENOSPC: "free some space, or write elsewhere",
    errno.ENOTDIR: "give a folder: what is in its place is a file",
}


def write_file(path: Path, content: bytes | memoryview | str, flush: bool = True) -> Path:
    """Write a file whole and return its path; on any failure the old file is as it was.

    The content is written beside it and flushed to the disk, then takes its place at once. A link
    stays a link; what is no regular file, a pipe or ``/dev/stdout``, is written to. Raises an
    OSError that has number and path and says what to do.
    """
    data = content.encode() if isinstance(content, str) else content
    with _explained(path):
        mode = path.stat().st_mode if os.path.exists(path) else None
        if mode is not None and not stat.S_ISREG(mode):
            with path.open("wb") as stream:
                stream.write(data)
            return path
        place = Path(os.path.realpath(path))
        if mode is not None and not os.access(place, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        beside = place.with_name(f".tenscontrol-{os.urandom(8).hex()}")
        try:
            with beside.open("xb") as stream:
                stream.write(data)
                stream.flush()
                if flush:
                    os.fsync(stream.fileno())
            if mode is not None:
                beside.chmod(stat.S_IMODE(mode))
            os.replace(beside, place)
        except BaseException:  # Ctrl-C too
            with suppress(OSError):
                beside.unlink()
            raise
    return path


def read_file(path: Path, most: int) -> bytes:
    """Return what a file holds.

    Raises an OSError that has number and path where it cannot be read, is no regular file (a pipe
    may never end) or has more bytes than ``most``.
    """
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "it is a folder, a pipe or a device")
        with path.open("rb") as stream:  # room is taken for as many bytes as are asked for
            content = stream.read(min(most, found.st_size) + 1)
    except OSError as error:
        number = error.errno or errno.EIO
        said = f"cannot be read: {error.strerror or error}"
        raise OSError(number, said, str(path)) from None
    if len(content) > most:
        raise OSError(errno.EFBIG, f"is too large: at most {most:,} bytes are read", str(path))
    return content


def make_folder(path: Path) -> Path:
    """Return a folder that is there, made with those above it; errors as :func:`write_file`."""
    with _explained(path):
        path.mkdir(parents=True, exist_ok=True)
    return path


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Put the path and what to do into an error of the file system."""
    try:
        yield
    except OSError as error:
        number = error.errno or errno.EIO
        said = f"cannot write: {error.strerror or error}; {_REMEDY.get(number, 'write elsewhere')}"
        raise OSError(number, said, str(path)) from None
