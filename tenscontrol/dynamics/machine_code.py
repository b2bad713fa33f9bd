"""Machine code: the C compiler of the machine, the cache of libraries, and compiled functions.

A library is code that runs with the rights of the user, so nothing is loaded from the cache that
another user may have written.
"""

from __future__ import annotations

import atexit
import os
import platform
import re
import shlex
import shutil
import stat
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from time import perf_counter, time
from typing import TypeVar

import casadi as ca
import numpy as np

from tenscontrol import processes
from tenscontrol.dynamics.evaluator import builds, paused
from tenscontrol.files import write_file
from tenscontrol.validation import LONGEST_WAIT, instance, positive_number

#: Environment variable that names the compiler, before ``CC``; ``none`` switches compiling off.
VARIABLE = "TENSCONTROL_COMPILER"

# Programs that are looked for where no variable names one.
_USUAL = ("cc", "gcc", "clang")

# For the same bits as CasADi's virtual machine: no multiplication and addition rounded as one
# (also what ISO C asks for). A square root need not set errno: that is a branch less, and the
# same number. Without interposition the small functions that CasADi exports are put in line,
# which saves a quarter of the instructions. ISO C keeps names such as `gamma` free for functions.
# Nobody looks at the flags that an operation raises, so both sides of a choice may be worked out.
FLAGS = (
    "-O3",
    "-std=c99",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fno-semantic-interposition",
    "-fPIC",
    "-shared",
)

# How a POSIX shell runs a compiler. Its standard input is a pipe whose other end is held by this
# process alone: if that is closed without a word, as when this process is killed, the compiler is
# ended with all that it has started, and the folder in which it works is removed.
_WATCHED = """
exec 3<&0 </dev/null
{ read -r done && exit
  trap '' TERM; kill -TERM 0; [ -z "$0" ] || rm -rf -- "$0"; kill -KILL 0
} <&3 3<&- >/dev/null 2>&1 &
exec "$@" 3<&-
"""

_VERSION_TIMEOUT = 30.0  # s
_which = cache(shutil.which)
_LINES = 8  # of what the compiler says that go into a message

_ADVICE = (
    f"Set the environment variable {VARIABLE} or CC to a C compiler that works, or "
    f"{VARIABLE}=none to run without one"
)


_Value = TypeVar("_Value")


class CompilerError(RuntimeError):
    """A C compiler that is not there, or does not do its work."""


class CompilerWarning(RuntimeWarning):
    """Something could not be compiled and runs uncompiled: the same numbers, later."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler."""

    command: tuple[str, ...]  # path of the program, and arguments that always go first
    version: str  # what it says of itself

    def link(
        self,
        sources: Sequence[Path],
        folder: Path,
        name: str,
        timeout: float,
        extra: tuple[str, ...] = (),
    ) -> Path:
        """Compile files of C code to one library and return its path.

        ``sources`` are seen from the folder, which goes if this process is killed; ``name`` is
        without ending, ``extra`` are options that go after all others. Raises CompilerError if the
        compiler fails, writes nothing, or takes longer than ``timeout``, s.
        """
        library = folder / f"{name}{suffix()}"
        files = [str(source) for source in sources]
        command = [*self.command, *FLAGS, *extra, *files, "-o", library.name, *_libraries()]
        status, said = _run(command, folder, timeout)
        if status is None:
            raise CompilerError(f"{self.command[0]} was stopped after {timeout:g} s. {_ADVICE}")
        if status != 0 or not library.is_file():
            what = f"failed with exit status {status}" if status else "wrote no library"
            lines = "\n".join(f"  {line}" for line in said.splitlines()[:_LINES])
            raise CompilerError(f"{self.command[0]} {what}. {_ADVICE}. It said:\n{lines}")
        return library


def compiler() -> Compiler | None:
    """Return the C compiler of this machine, or None if there is none.

    It is the one that the environment variable ``TENSCONTROL_COMPILER`` names,
    else the one that ``CC`` names, else the first of ``cc``, ``gcc`` and
    ``clang`` on the path that answers. ``TENSCONTROL_COMPILER=none`` switches
    compiling off: then there is none. A program with the options of GCC is needed.

    Raises CompilerError if one of the variables names a program that is not there or does not run.
    """
    if os.getenv(VARIABLE, "").strip().lower() == "none":
        return None
    for variable in (VARIABLE, "CC"):
        asked = os.getenv(variable, "").strip()
        if asked:
            return _asked_for(variable, asked)
    for name in _USUAL:
        path = _which(name, path=os.getenv("PATH"))
        version = None if path is None or _is_stub(path) else _version((path,))
        if path is not None and version is not None:
            return Compiler((path,), version)
    return None


def suffix() -> str:
    """Return how the name of a library ends."""
    return ".dll" if os.name == "nt" else ".so"


def _asked_for(variable: str, asked: str) -> Compiler:
    # A path with blanks is a program; "ccache gcc" is a program and an argument.
    try:
        words = [asked] if shutil.which(asked) else shlex.split(asked)
    except ValueError as error:
        raise CompilerError(
            f"{variable} is {asked!r}, expected a program and its arguments, but it has "
            f"{str(error).lower()}. {_ADVICE}"
        ) from None
    path = shutil.which(words[0])
    if path is None:
        raise CompilerError(f"{variable} is {asked!r}, and there is no such program. {_ADVICE}")
    command = (path, *words[1:])
    version = _version(command)
    if version is None:
        raise CompilerError(f"{variable} is {asked!r}, which fails at --version. {_ADVICE}")
    return Compiler(command, version)


@cache
def _version(command: tuple[str, ...]) -> str | None:
    """Return what a compiler says of itself, or None if it does not run."""
    try:
        status, said = _run([*command, "--version"], None, _VERSION_TIMEOUT)
    except OSError:
        return None
    return said if status == 0 else None


def _is_stub(path: str) -> bool:
    """Whether a program of macOS is there only to open a window that offers to install it."""
    if platform.system() != "Darwin" or not path.startswith("/usr/bin/"):
        return False
    return _run(["/usr/bin/xcode-select", "-p"], None, _VERSION_TIMEOUT)[0] != 0


@cache
def _for_processor() -> tuple[str, ...]:
    """Return flags for wider registers, where the processor has them: the same bits, sooner."""
    if platform.machine() == "x86_64" and sys.platform.startswith("linux"):
        with suppress(OSError):
            if " avx2 " in Path("/proc/cpuinfo").read_text(encoding="utf-8"):
                return ("-mavx2",)
    return ()


def _libraries() -> list[str]:
    # An undefined symbol ends the link here; else it would end the program at the first call.
    return ["-lm", "-Wl,--no-undefined"] if sys.platform.startswith("linux") else ["-lm"]


def _run(command: list[str], folder: Path | None, timeout: float) -> tuple[int | None, str]:
    """Return exit status, None if time ran out, and what a program said."""
    environment = {**os.environ, "LC_ALL": "C"}
    if folder is not None:
        environment["TMPDIR"] = str(folder)  # goes with the folder, whatever happens
    if os.name != "nt":
        command = ["/bin/sh", "-c", _WATCHED, str(folder or ""), *command]
    end, held = (os.fdopen(each, mode) for each, mode in zip(os.pipe(), ("rb", "wb"), strict=True))
    with (
        end,
        held,
        subprocess.Popen(
            command,
            cwd=folder,
            env=environment,
            stdin=end,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,
        ) as process,
    ):
        try:
            said, _ = process.communicate(timeout=timeout)
            held.write(b"done\n")
        except subprocess.TimeoutExpired:
            return None, ""
        finally:
            # Also at Ctrl-C: what the compiler has started must not go on without it.
            if process.returncode is None:
                held.close()
                if os.name == "nt":
                    process.kill()
                process.communicate()
    return process.returncode, said


_DIGITS = 32  # of each hash in a file name: 128 bits


@dataclass(frozen=True)
class Cache:
    """A folder of libraries; whether it is temporary, and so goes when the process ends.

    A library's name is the key of what it was made from, then the hash of its
    own content: that shows whether the file is whole, and one file needs no
    second one beside it that could be out of step.
    """

    folder: Path
    temporary: bool

    def find(self, key: str) -> Path | None:
        """Return the library of a key, or None. One that is not whole is removed."""
        for path in sorted(self.folder.glob(f"{key}-*{suffix()}")):
            _refuse_unsafe(path, "file", "remove it")
            if path == self._place(key, path.read_bytes()):
                return path
            path.unlink(missing_ok=True)
        return None

    def add(self, key: str, library: Path) -> Path:
        """Move a library that was made on the same file system to its place, in one operation."""
        library.chmod(0o700)
        place = self._place(key, library.read_bytes())
        # Another process may have been first; then it is the same file.
        if not place.exists():
            os.replace(library, place)
        return place

    def _place(self, key: str, content: bytes) -> Path:
        return self.folder / f"{key}-{sha256(content).hexdigest()[:_DIGITS]}{suffix()}"


def open_cache() -> Cache:
    """Return the cache of the user, or a temporary one where that cannot be written."""
    folder = _user_folder()
    if folder is None:
        return _temporary()
    try:
        with suppress(FileExistsError):  # of something that is no folder: told below
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return _temporary()
    _refuse_unsafe(
        folder, "folder", "correct it (chmod 700), or set XDG_CACHE_HOME to another folder"
    )
    return Cache(folder, False) if os.access(folder, os.W_OK | os.X_OK) else _temporary()


def _user_folder() -> Path | None:
    """Return where the system wants the cache, or None if the user has no home."""
    given = Path(os.getenv("XDG_CACHE_HOME", ""))
    if given.is_absolute():  # on every system; the specification says to ignore a relative one
        return given / "tenscontrol"
    from platformdirs import user_cache_path

    folder = user_cache_path("tenscontrol", appauthor=False, opinion=False)
    return folder if folder.is_absolute() else None


@cache
def _temporary() -> Cache:
    """Return one private cache for the process, removed at its end."""
    folder = tempfile.mkdtemp(prefix="tenscontrol-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)  # Windows keeps a library in use
    return Cache(Path(folder), temporary=True)


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


@dataclass(frozen=True, eq=False)
class Compiled:
    """A CasADi function in machine code.

    Attributes
    ----------
    function : casadi.Function
        Name, inputs and outputs as the function it was made of. It has no derivatives.
    library : Path
        The file with the code.
    seconds : float
        Time that it took to write, compile and load the code, s.
    cached : bool
        Whether the library was there already.
    temporary : bool
        Whether the library goes when the process ends, because the cache folder cannot be written.
    compiler : Compiler
    """

    function: ca.Function
    library: Path
    seconds: float
    cached: bool
    temporary: bool
    compiler: Compiler


@builds
def compiled(function: ca.Function, timeout: float = 600.0) -> Compiled | None:
    """Return a function in machine code, or None on a machine without a C compiler.

    The code does the same operations in the same order as CasADi's virtual machine, and gives the
    same numbers to the last bit; only what is not a number may have another sign. It is four times
    as fast or more. The library is kept in the user's cache folder, so that the next run need not
    compile again: ``$XDG_CACHE_HOME/tenscontrol``, else ``~/.cache/tenscontrol``, on macOS
    ``~/Library/Caches/tenscontrol``, on Windows ``tenscontrol`` in ``%LOCALAPPDATA%``. It may be
    deleted at any time. A process that is killed takes its compiler with it, except on Windows.

    Parameters
    ----------
    function : casadi.Function
        Of SX or MX, with all that it calls. What CasADi cannot write as C code,
        such as a callback into Python, cannot be compiled.
    timeout : float
        Longest time that the compiler may take, s; at most a day.

    Returns
    -------
    Compiled or None
        None where :func:`compiler` finds none, or it is switched off by
        ``TENSCONTROL_COMPILER=none``: then call ``function`` itself.

    Raises
    ------
    CompilerError
        If the compiler fails or takes too long, or its library cannot be loaded.
    PermissionError
        If another user could have written the library or its folder: it is not loaded.
    TypeError, ValueError
        If ``function`` is no CasADi function, or calls one that is compiled
        already: compile the whole instead.

    Notes
    -----
    Long straight code (SX) is compiled in parts, so that the time grows in proportion to its
    length: about a quarter of a millisecond an instruction. A graph (MX) that calls a small
    function many times runs as fast and compiles in the time of the small one.

    Examples
    --------
    >>> import casadi as ca
    >>> from tenscontrol.dynamics.machine_code import compiled
    >>> x = ca.SX.sym("x")
    >>> square = ca.Function("square", [x], [x**2])
    >>> fast = compiled(square)
    >>> run = square if fast is None else fast.function
    >>> float(run(3.0))
    9.0
    """
    instance("function", function, ca.Function, "make one by casadi.Function(...)")
    timeout = positive_number("timeout", timeout, "s", LONGEST_WAIT)
    for part in (function, *function.find_functions()):
        if part.class_name() == "External":
            raise ValueError(
                f"function calls {part.name()!r}, which is compiled already; compile a function "
                f"of what {part.name()!r} was made of instead"
            )
    found = compiler()
    if found is None:
        return None
    began = perf_counter()
    library, cached, kept = _library(_source(function), found, timeout)
    loaded = _load(function.name(), library)
    seconds = perf_counter() - began
    return Compiled(loaded, library, seconds, cached, kept.temporary, found)


def if_compiled(make: Callable[[], _Value]) -> _Value | None:
    """Return what is compiled, or None with a warning if the compiler or the cache folder fails.

    A library that another user may have written is refused all the same.
    """
    try:
        return make()
    except PermissionError:
        raise
    except (CompilerError, OSError) as error:
        warnings.warn(
            f"runs uncompiled, which takes several times as long: {error}",
            CompilerWarning,
            stacklevel=2,
        )
        return None


def compiled_source(source: str, names: tuple[str, ...]) -> tuple[ca.Function, ...]:
    """Return the functions of a C text that has CasADi's interface for external functions.

    Raises FileNotFoundError if there is no C compiler, or it is switched off; else as
    :func:`compiled`.
    """
    library = compiled_library(source)
    return tuple(_load(name, library) for name in names)


def compiled_library(source: str) -> Path:
    """Return the library of a C text; errors as :func:`compiled_source`."""
    found = compiler()
    if found is None:
        raise FileNotFoundError(
            "there is no C compiler: none of $CC, cc, gcc and clang is on the path, or it is "
            "switched off by TENSCONTROL_COMPILER. Install one, or go without compiled functions"
        )
    library, *_ = _library(source, found, timeout=600.0)
    return library


@paused()
def _library(source: str, found: Compiler, timeout: float) -> tuple[Path, bool, Cache]:
    """Return the library made of C code, whether it was there already, and where."""
    machine = (sys.platform, platform.machine(), *platform.libc_ver())
    # All that a library depends on.
    flags = _for_processor()
    parts = (source, *found.command, found.version, *FLAGS, *flags, ca.__version__, *machine)
    key = sha256("\0".join(parts).encode()).hexdigest()[:_DIGITS]
    kept = open_cache()
    library = kept.find(key)
    cached = library is not None
    if library is None:
        with _new_folder(kept.folder) as folder:
            # Names without a folder: the library must not depend on where it was made.
            write_file(folder / "function.c", source, flush=False)
            made = found.link([Path("function.c")], folder, "function", timeout, flags)
            library = kept.add(key, made)
    return library, cached, kept


@contextmanager
def _new_folder(parent: Path) -> Iterator[Path]:
    """Yield a folder to compile in, removed afterwards; one that a dead process left goes first."""
    for left in parent.glob("making-*"):
        with suppress(OSError):  # it may just be removed by its owner
            # A young one may not be locked yet.
            if time() > left.stat().st_mtime + 10.0:
                with processes.locked_file(left / "lock") as (_, locked):
                    if locked:
                        shutil.rmtree(left, ignore_errors=True)
    with (
        tempfile.TemporaryDirectory("", "making-", parent, ignore_cleanup_errors=True) as folder,
        processes.locked_file(Path(folder) / "lock"),
    ):
        yield Path(folder)


def _source(function: ca.Function) -> str:
    # One prefix for all internal names: they are of no concern outside of the library.
    code = ca.CodeGenerator("lib", {"with_header": False})
    code.add(function)
    return _STRAIGHT.sub(_in_parts, str(code.dump()))


# CasADi writes a function of SX as one piece of straight code with a branch at each result, and
# compilers take more than in proportion to its length. Functions from so many lines on are cut
# into parts of so many lines.
_LONG, _PART = 2000, 250
_STRAIGHT = re.compile(
    r"^(static int (casadi_f\d+)\(.*\n)(?:  casadi_real a\d+(?:, a\d+)*;\n)++"
    r"((?:  (?:if \(res\[\d+\]!=0\) res\[\d+\]\[\d+\]=a\d+"
    r"|a\d+=(?:arg\[\d+\]\? arg\[\d+\]\[\d+\] : 0|[^\[\n]*));\n)++)  return 0;\n}\n",
    re.MULTILINE,
)
_GIVEN = re.compile(r"arg\[(\d+)\]\? arg\[\1\]\[(\d+)\] : 0")
_FOUND = re.compile(r"if \(res\[(\d+)\]!=0\) res\[\1\]\[(\d+)\]")
_VARIABLE = re.compile(r"\ba(\d+)\b")

_PART_TEXT = """\
static __attribute__((noinline))
void %(name)s_%(number)d(const casadi_real** arg, casadi_real** res, casadi_real* a) {
%(declared)s
%(lines)s
%(kept)s
}
"""

# Each result is written: what nobody wants goes to memory that is freed. Arguments not given are 0.
_WHOLE_TEXT = """\
#include <stdlib.h>
%(head)s  static const casadi_real zeros[%(longest_given)d] = {0};
  const casadi_real *given[%(given)d];
  casadi_real a[%(variables)d], *unused = 0, *found[%(found)d];
  int k;
  for (k = 0; k < %(given)d; ++k) given[k] = arg[k] ? arg[k] : zeros;
  for (k = 0; k < %(found)d; ++k) {
    if (!res[k] && !unused && !(unused = malloc(%(longest_found)d * sizeof(*unused)))) return 1;
    found[k] = res[k] ? res[k] : unused;
  }
%(calls)s
  free(unused);
  return 0;
}
"""


def _in_parts(match: re.Match[str]) -> str:
    """Return the text of a straight function in parts, each with variables of its own.

    The array ``a`` holds what a part has to hand on. The operations and their order stay.
    """
    head, name, body = match.groups()
    if body.count("\n") < _LONG:
        return match[0]
    places = [np.array(each.findall(body), int).reshape(-1, 2) for each in (_GIVEN, _FOUND)]
    sizes = [part.max(axis=0, initial=0) + 1 for part in places]
    lines = _FOUND.sub(r"res[\1][\2]", _GIVEN.sub(r"arg[\1][\2]", body)).splitlines()
    count = -(-len(lines) // _PART)
    texts: list[str] = []
    needed: dict[str, None] = {}  # by later parts, in an order that does not change
    for number in reversed(range(count)):
        part = lines[number * _PART : (number + 1) * _PART]
        read: dict[str, None] = {}
        written: dict[str, None] = {}
        for left, _, right in (line.partition("=") for line in part):
            read |= dict.fromkeys(v for v in _VARIABLE.findall(right) if v not in written)
            written |= dict.fromkeys(_VARIABLE.findall(left))
        starts = (f"  casadi_real a{v}{f'=a[{int(v)}]' * (v in read)};" for v in read | written)
        ends = (f"  a[{int(v)}]=a{v};" for v in written if v in needed)
        inside = {"declared": starts, "lines": part, "kept": ends}
        joined = {key: "\n".join(each) for key, each in inside.items()}
        texts.append(_PART_TEXT % {"name": name, "number": number, **joined})
        needed = read | {v: None for v in needed if v not in written}
    whole = _WHOLE_TEXT % {
        "head": head,
        "given": sizes[0][0],
        "longest_given": sizes[0][1],
        "found": sizes[1][0],
        "longest_found": sizes[1][1],
        "variables": 1 + max(map(int, _VARIABLE.findall(body))),
        "calls": "\n".join(f"  {name}_{k}(given, found, a);" for k in range(count)),
    }
    return "".join([*texts, whole])


def _load(name: str, library: Path) -> ca.Function:
    try:
        return ca.external(name, str(library))
    except RuntimeError as error:
        library.unlink(missing_ok=True)
        # CasADi says in many lines where else it has looked.
        lines = [line.strip() for line in str(error).splitlines() if f": {library}: " in line]
        raise CompilerError(
            f"the compiled code of {name!r} cannot be loaded: {lines or error}. The compiler may "
            f"be one for another machine: see CC; or the system may not run code from "
            f"{library.parent}: set XDG_CACHE_HOME to another folder"
        ) from None
