"""CasADi functions as machine code, by the C compiler of the machine."""

from __future__ import annotations

import platform
import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import casadi as ca

from tenscontrol.dynamics.compiler import FLAGS, Compiler, CompilerError, compiler
from tenscontrol.dynamics.compiler_cache import Cache, key_of, open_cache
from tenscontrol.validation import instance, positive_number


@dataclass(frozen=True, eq=False)
class Compiled:
    """A function in machine code.

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
        Whether the library goes when the process ends, because the cache folder
        cannot be written.
    compiler : Compiler
    """

    function: ca.Function
    library: Path
    seconds: float
    cached: bool
    temporary: bool
    compiler: Compiler


def compiled(function: ca.Function, timeout: float = 600.0) -> Compiled | None:
    """Return a function in machine code, or None on a machine without a C compiler.

    The code does the same operations in the same order as CasADi's virtual
    machine, and gives the same numbers to the last bit; only what is not a
    number may have another sign. It is four times as fast or more. The library
    is kept in the user's cache folder, so that the next run need not compile
    again: ``$XDG_CACHE_HOME/tenscontrol``, else
    ``~/.cache/tenscontrol``, on macOS ``~/Library/Caches/tenscontrol``, on
    Windows ``tenscontrol`` in ``%LOCALAPPDATA%``. It may be deleted at any time.

    Parameters
    ----------
    function : casadi.Function
        Of SX or MX, with all that it calls. What CasADi cannot write as C code,
        such as a callback into Python, cannot be compiled.
    timeout : float
        Longest time that the compiler may take, s.

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
    One long straight piece of code (SX) compiles slowly: about half a
    millisecond an instruction, more than in proportion beyond some ten
    thousand. A graph (MX) that calls a small function many times runs as fast
    and compiles in the time of the small one.

    Examples
    --------
    >>> import casadi as ca
    >>> from tenscontrol.dynamics.compiled import compiled
    >>> x = ca.SX.sym("x")
    >>> square = ca.Function("square", [x], [x**2])
    >>> fast = compiled(square)
    >>> run = square if fast is None else fast.function
    >>> float(run(3.0))
    9.0
    """
    instance("function", function, ca.Function, "make one by casadi.Function(...)")
    timeout = positive_number("timeout", timeout, "s")
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
    library, cached, cache = _library(_source(function), found, timeout)
    loaded = _load(function.name(), library)
    seconds = perf_counter() - began
    return Compiled(loaded, library, seconds, cached, cache.temporary, found)


def compiled_source(source: str, names: tuple[str, ...]) -> tuple[ca.Function, ...]:
    """Return the functions of a C text that has CasADi's interface for external functions.

    Parameters
    ----------
    source : str
        C code.
    names : tuple of str
        Names of the functions.

    Returns
    -------
    tuple of casadi.Function

    Raises
    ------
    FileNotFoundError
        If there is no C compiler, or it is switched off.
    CompilerError
        If the compiler fails, or its library cannot be loaded.
    PermissionError
        If another user could have written the library or its folder: it is not loaded.
    """
    library = compiled_library(source)
    return tuple(_load(name, library) for name in names)


def compiled_library(source: str) -> Path:
    """Return the library of a C text; errors as :func:`compiled_source`.

    Parameters
    ----------
    source : str
        C code.
    """
    found = compiler()
    if found is None:
        raise FileNotFoundError(
            "there is no C compiler: none of $CC, cc, gcc and clang is on the path, or it is "
            "switched off by TENSCONTROL_COMPILER. Install one, or go without compiled functions"
        )
    library, *_ = _library(source, found, timeout=600.0)
    return library


def _library(source: str, found: Compiler, timeout: float) -> tuple[Path, bool, Cache]:
    """Return the library made of C code, whether it was there already, and where."""
    machine = (sys.platform, platform.machine(), *platform.libc_ver())
    key = key_of(source, found, FLAGS, ca.__version__, *machine)
    cache = open_cache()
    library = cache.find(key)
    cached = library is not None
    if library is None:
        with cache.workshop() as folder:
            library = cache.add(key, found.build(source, Path(folder), timeout))
    return library, cached, cache


def _source(function: ca.Function) -> str:
    # One prefix for all internal names: they are of no concern outside of the library.
    code = ca.CodeGenerator("lib", {"with_header": False})
    code.add(function)
    return str(code.dump())


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
