"""Files read, and written whole: all that was meant for one, or what it held before."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

# What to do about an error of the file system, by its number; else only writing elsewhere helps.
_REMEDY = {
    errno.EEXIST: "give another name, or remove what is there",
    errno.EISDIR: "give the name of a file: this is a folder",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.ENOENT: "make its folder first",
    errno.ENOSPC: "free some space, or write elsewhere",
    errno.ENOTDIR: "give a folder: what is in its place is a file",
}

# Without waiting: what was a file may have become a pipe to which nobody writes.
_AT_ONCE = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def write_file(
    path: Path, content: bytes | memoryview | str | Callable[[BinaryIO], object], flush: bool = True
) -> Path:
    """Write a file whole and return its path; on any failure the old file is as it was.

    The content, or what a function writes to a stream, is written beside it and flushed to the
    disk, then takes its place at once. A link stays a link; what is no regular file, a pipe or
    ``/dev/stdout``, is written to. Raises an
    OSError that has number and path and says what to do.
    """
    data = content.encode() if isinstance(content, str) else content

    def fill(stream: BinaryIO) -> None:
        if callable(data):
            data(stream)
        else:
            stream.write(data)

    with _explained(path):
        mode = path.stat().st_mode if os.path.exists(path) else None
        if mode is not None and not stat.S_ISREG(mode):
            with path.open("wb") as stream:
                fill(stream)
            return path
        target = Path(os.path.realpath(path))
        if mode is not None and not os.access(target, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        beside = target.with_name(f".tenscontrol-{os.urandom(8).hex()}")
        try:
            with beside.open("xb") as stream:
                fill(stream)
                stream.flush()
                if flush:
                    os.fsync(stream.fileno())
            if mode is not None:
                beside.chmod(stat.S_IMODE(mode))
            os.replace(beside, target)
        except BaseException:  # Ctrl-C too
            with suppress(OSError):
                beside.unlink()
            raise
    return path


def append_file(path: Path, text: str) -> None:
    """Add text to a file, or make it, and flush it to the disk; errors as :func:`write_file`."""
    with _explained(path), path.open("ab") as stream:
        stream.write(text.encode())
        stream.flush()
        os.fsync(stream.fileno())


@contextmanager
def opened_file(path: Path, most: int) -> Iterator[BufferedReader]:
    """Yield a regular file, open to read its bytes. All readers of files come through here.

    Raises an OSError that has number and path where it cannot be read, is no regular file (a pipe
    may never end) or has more bytes than ``most``.
    """
    with _explained(path, "cannot be read: {}"):
        _refuse_irregular(path.stat())  # a device may act on being opened
        descriptor = os.open(path, os.O_RDONLY | _AT_ONCE)
    with os.fdopen(descriptor, "rb") as stream, _explained(path, "cannot be read: {}"):
        status = os.fstat(stream.fileno())
        _refuse_irregular(status)
        if status.st_size > most:
            reason = f"it is too large: {status.st_size:,} bytes, at most {most:,} are read"
            raise OSError(errno.EFBIG, reason)
        yield stream


def _refuse_irregular(status: os.stat_result) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder, expected a file")
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device, expected a regular file")


def read_file(path: Path, most: int) -> bytes:
    """Return what a file holds; errors as :func:`opened_file`."""
    with opened_file(path, most) as stream:
        return stream.read(os.fstat(stream.fileno()).st_size)


def read_text(path: Path, most: int) -> str:
    r"""Return the text of a file in UTF-8, a line ending in ``\n``; errors as :func:`opened_file`.

    Raises a ValueError that has file and line where it is not UTF-8.
    """
    content = read_file(path, most)
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ValueError(f"{path}:{line}: not UTF-8 text: {error.reason}") from error


def make_folder(path: Path) -> Path:
    """Return a folder that is there, made with those above it; errors as :func:`write_file`."""
    with _explained(path):
        path.mkdir(parents=True, exist_ok=True)
    return path


@contextmanager
def _explained(path: Path, template: str = "cannot write: {}; {}") -> Iterator[None]:
    """Put the path and what to do into an error of the file system."""
    try:
        yield
    except OSError as error:
        number = error.errno or errno.EIO
        message = template.format(error.strerror or error, _REMEDY.get(number, "write elsewhere"))
        raise OSError(number, message, str(path)) from None
