"""Machine code: C text compiled by the user's C compiler into libraries of the user's cache."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

import casadi as ca

from tenscontrol import validation
from tenscontrol.dynamics.evaluator import builds
from tenscontrol.files import write_file
from tenscontrol.warn import warn

#: Environment variable that names the compiler, before ``CC``; ``none`` switches compiling off.
VARIABLE = "TENSCONTROL_COMPILER"

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

# Lines of C from which the time of -O3 grows faster than they do, while straight code runs no
# sooner for it.
_LONG = 5000

_SAID = 8  # lines of what the compiler says that go into a message

_ADVICE = (
    f"Set the environment variable {VARIABLE} or CC to a C compiler that works, or "
    f"{VARIABLE}=none to run without one"
)

_Value = TypeVar("_Value")


class CompilerError(RuntimeError):
    """A C compiler that is not there, or does not do its work."""


class CompilerWarning(RuntimeWarning):
    """Something could not be compiled and runs uncompiled: the same numbers, later."""


def compiler() -> tuple[str, ...] | None:
    """Return the command of this machine's C compiler, or None if there is none.

    It is the one that the environment variable ``TENSCONTROL_COMPILER`` names, else the one that
    ``CC`` names, else the first of ``cc``, ``gcc`` and ``clang`` on the path.
    ``TENSCONTROL_COMPILER=none`` switches compiling off: then there is none. A program with the
    options of GCC is needed.

    Raises CompilerError if one of the variables names a program that is not there.
    """
    for variable in (VARIABLE, "CC"):
        asked = os.getenv(variable, "").strip()
        if variable == VARIABLE and asked.lower() == "none":
            return None
        if asked:
            return _named(variable, asked)
    return _usual(os.getenv("PATH"))


def _named(variable: str, asked: str) -> tuple[str, ...]:
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
    return (path, *words[1:])


@cache
def _usual(folders: str | None) -> tuple[str, ...] | None:
    paths = [shutil.which(name, path=folders) for name in ("cc", "gcc", "clang")]
    path = next((path for path in paths if path is not None), None)
    if path is not None and sys.platform == "darwin" and path.startswith("/usr/bin/"):
        # Without the developer tools, that program opens a window that offers to install them.
        if subprocess.run(["/usr/bin/xcode-select", "-p"], capture_output=True).returncode:
            return None
    return None if path is None else (path,)


@builds
def compiled(function: ca.Function, timeout: float = 600.0) -> ca.Function | None:
    """Return a function in machine code, or None on a machine without a C compiler.

    The code does the same operations in the same order as CasADi's virtual machine, and gives the
    same numbers to the last bit; only what is not a number may have another sign. It is four times
    as fast or more. The library is kept in the user's cache folder, so that the next run need not
    compile again: ``$XDG_CACHE_HOME/tenscontrol``, else ``~/.cache/tenscontrol``, on macOS
    ``~/Library/Caches/tenscontrol``, on Windows ``tenscontrol`` in ``%LOCALAPPDATA%``. It may be
    deleted at any time.

    Parameters
    ----------
    function : casadi.Function
        Of SX or MX, with all that it calls. What CasADi cannot write as C code,
        such as a callback into Python, cannot be compiled.
    timeout : float
        Longest time that the compiler may take, s; at most a day.

    Returns
    -------
    casadi.Function or None
        Name, inputs and outputs as the function it was made of. It has no derivatives. None where
        :func:`compiler` finds none, or it is switched off by ``TENSCONTROL_COMPILER=none``: then
        call ``function`` itself.

    Raises
    ------
    CompilerError
        If the compiler fails or takes too long, or its library cannot be loaded.
    PermissionError
        If other users may write to the cache folder: nothing is loaded from it.
    TypeError, ValueError
        If ``function`` is no CasADi function, or calls one that is compiled
        already: compile the whole instead.

    Notes
    -----
    The time grows in proportion to the length of straight code (SX): about a quarter of a
    millisecond an instruction. A graph (MX) that calls a small function many times runs as fast
    and compiles in the time of the small one.

    Examples
    --------
    >>> import casadi as ca
    >>> from tenscontrol.dynamics.machine_code import compiled
    >>> x = ca.SX.sym("x")
    >>> square = ca.Function("square", [x], [x**2])
    >>> fast = compiled(square) or square
    >>> float(fast(3.0))
    9.0
    """
    validation.instance("function", function, ca.Function, "make one by casadi.Function(...)")
    timeout = validation.positive_number("timeout", timeout, "s", validation.LONGEST_WAIT)
    for called in (function, *function.find_functions()):
        if called.class_name() == "External":
            raise ValueError(
                f"function calls {called.name()!r}, which is compiled already; compile a function "
                f"of what {called.name()!r} was made of instead"
            )
    if compiler() is None:
        return None
    return _load(function.name(), compiled_library(_source(function), timeout))


def _source(function: ca.Function) -> str:
    # One prefix for all internal names: they are of no concern outside of the library.
    code = ca.CodeGenerator("lib", {"with_header": False})
    code.add(function)
    return str(code.dump())


def if_compiled(make: Callable[[], _Value]) -> _Value | None:
    """Return what is compiled, or None with a warning if the compiler or the cache folder fails.

    A cache folder to which other users may write is refused all the same.
    """
    try:
        return make()
    except PermissionError:
        raise
    except (CompilerError, OSError) as error:
        warn(
            f"runs uncompiled, which takes several times as long: {error}",
            CompilerWarning,
        )
        return None


def compiled_source(source: str, names: tuple[str, ...]) -> tuple[ca.Function, ...]:
    """Return the functions of a C text that has CasADi's interface for external functions.

    Errors as :func:`compiled_library`.
    """
    library = compiled_library(source)
    return tuple(_load(name, library) for name in names)


@builds
def compiled_library(source: str, timeout: float = 600.0) -> Path:
    """Return the library of a C text: from the cache, or compiled for it.

    Processes that want the same library wait for the first one. Raises FileNotFoundError if there
    is no C compiler, or it is switched off; else as :func:`compiled`.
    """
    import filelock

    command = compiler()
    if command is None:
        raise FileNotFoundError(
            "there is no C compiler: none of $CC, cc, gcc and clang is on the path, or it is "
            "switched off by TENSCONTROL_COMPILER. Install one, or go without compiled functions"
        )
    options = _for_processor() + ("-O1",) * (source.count("\n") > _LONG)
    machine = (sys.platform, platform.machine(), *platform.libc_ver(), ca.__version__)
    key = sha256("\0".join((source, *command, *FLAGS, *options, *machine)).encode()).hexdigest()
    folder = _cache_folder()
    library = folder / f"{key[:32]}{'.dll' if os.name == 'nt' else '.so'}"
    if library.exists():
        return library
    with filelock.FileLock(library.with_suffix(".lock"), timeout=timeout):
        if not library.exists():
            with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as work:
                file = write_file(Path(work) / "function.c", source, flush=False)
                link(command, [file], file.with_suffix(library.suffix), timeout, options)
                os.replace(file.with_suffix(library.suffix), library)
    return library


def link(
    command: Sequence[str],
    sources: Sequence[Path],
    library: Path,
    timeout: float,
    options: Sequence[str] = (),
) -> None:
    """Compile files of C code to a library; ``options`` go after all others.

    Raises CompilerError if the compiler fails, writes nothing, or takes longer than ``timeout``, s.
    """
    # An undefined symbol ends the link here; else it would end the program at the first call.
    libraries = ["-lm", "-Wl,--no-undefined"] if sys.platform.startswith("linux") else ["-lm"]
    files = [*map(str, sources), "-o", str(library)]
    try:
        done = subprocess.run(
            [*command, *FLAGS, *options, *files, *libraries],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            encoding="utf-8", errors="replace", timeout=timeout,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise CompilerError(f"{command[0]} was stopped after {timeout:g} s. {_ADVICE}") from None
    status = done.returncode
    if status != 0 or not library.is_file():
        failure = f"failed with exit status {status}" if status else "wrote no library"
        lines = "\n".join(f"  {line}" for line in done.stdout.splitlines()[:_SAID])
        raise CompilerError(f"{command[0]} {failure}. {_ADVICE}. It said:\n{lines}")


@cache
def _for_processor() -> tuple[str, ...]:
    """Return flags for wider registers, where the processor has them: the same bits, sooner."""
    if platform.machine() == "x86_64" and sys.platform.startswith("linux"):
        with suppress(OSError):
            if " avx2 " in Path("/proc/cpuinfo").read_text(encoding="utf-8"):
                return ("-mavx2",)
    return ()


def _cache_folder() -> Path:
    """Return the cache folder of the user, or one of this process where that cannot be written.

    A library is code that runs with the rights of the user, so nobody else may write to it.
    """
    from platformdirs import user_cache_path

    folder = user_cache_path("tenscontrol", appauthor=False, opinion=False)
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return _temporary_folder()
    status = folder.stat()
    # On Windows, others have no access to the profile of a user.
    if os.name != "nt" and (status.st_uid != os.geteuid() or status.st_mode & 0o022):
        raise PermissionError(
            f"compiled code is not loaded from {folder}, to which other users may write. Find out "
            "why and correct it (chmod 700), set XDG_CACHE_HOME to another folder, or set "
            f"{VARIABLE}=none to do without a compiler"
        )
    return folder if os.access(folder, os.W_OK | os.X_OK) else _temporary_folder()


def _temporary_folder() -> Path:
    return Path(_temporary().name)


@cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    """Return one private folder for the process, which removes it at its end."""
    # Windows keeps a library that is in use.
    return tempfile.TemporaryDirectory(prefix="tenscontrol-", ignore_cleanup_errors=True)


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
