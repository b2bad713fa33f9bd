"""Memory that compiled C code takes, and the functions that it needs."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory

from tenscontrol.dynamics.machine_code import CompilerError

# Warnings that are errors. Code by CasADi has parameters that it does not use.
_STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror", "-c")


@dataclass(frozen=True)
class MemoryUse:
    """What a controller takes on a machine. Made by :meth:`GeneratedController.memory`.

    Attributes
    ----------
    flash : int
        Code, constants and the first values of variables, bytes; without the C library.
    ram : int
        Variables, bytes; without the stack.
    functions : tuple of str
        Functions of the C library, and of the compiler, that the code calls.
    """

    flash: int
    ram: int
    functions: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"flash {self.flash / 1024:.1f} kB, RAM {self.ram / 1024:.1f} kB, "
            f"calls {', '.join(self.functions)}"
        )


def memory_use(
    compiler: str, sources: Sequence[Path], options: Sequence[str], timeout: float
) -> MemoryUse:
    """Return what some C files take; see :meth:`GeneratedController.memory`."""
    program = _tool(compiler, compiler)
    size, nm = (_tool(compiler, _beside(compiler, tool)) for tool in ("size", "nm"))
    with TemporaryDirectory(prefix="tenscontrol-") as folder:
        objects = []
        for source in sources:
            target = os.path.join(folder, f"{source.stem}.o")
            _output([program, *_STRICT, *options, str(source), "-o", target], timeout)
            objects.append(target)
        rows = [line.split() for line in _output([size, *objects], timeout).splitlines()[1:]]
        symbols = [line.split() for line in _output([nm, *objects], timeout).splitlines()]
    text, data, zeroed = (sum(int(row[i]) for row in rows) for i in range(3))
    own = {words[-1] for words in symbols if len(words) == 3}
    needed = {words[-1] for words in symbols if len(words) == 2 and words[0] == "U"} - own
    needed -= {"_GLOBAL_OFFSET_TABLE_"}  # of the linker
    return MemoryUse(text + data, data + zeroed, tuple(sorted(needed)))


def _beside(compiler: str, tool: str) -> str:
    """Return the name of a tool with the folder and prefix of a compiler."""
    folder, name = os.path.split(compiler)
    prefix = name[: name.rindex("-") + 1] if "-" in name else ""
    return os.path.join(folder, prefix + tool)


def _tool(compiler: str, name: str) -> str:
    program = which(name) or which(os.path.basename(name))
    if program is None:
        raise FileNotFoundError(
            f"compiler is {compiler!r}, but {name!r} is not on the path: install it, or name "
            "another, like 'cc'"
        )
    return program


def _output(command: Sequence[str], timeout: float) -> str:
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=timeout, check=False,
            env=os.environ | {"LC_ALL": "C"},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise CompilerError(f"{command[0]} took more than {timeout:g} s") from None
    if done.returncode:
        raise CompilerError(f"{command[0]} failed: {done.stderr.strip()[:2000]}")
    return done.stdout
