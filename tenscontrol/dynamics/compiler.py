"""The C compiler of the machine: which one it is, and how it is run."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

#: Environment variable that names the compiler, before ``CC``; ``none`` switches compiling off.
VARIABLE = "TENSCONTROL_COMPILER"

# Programs that are looked for where no variable names one.
_USUAL = ("cc", "gcc", "clang")

# For the same bits as CasADi's virtual machine: no multiplication and addition rounded as one
# (also what ISO C asks for). A square root need not set errno: that is a branch less, and the
# same number. Without interposition the small functions that CasADi exports are put in line,
# which saves a quarter of the instructions. ISO C keeps names such as `gamma` free for functions.
FLAGS = (
    "-O3",
    "-std=c99",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-semantic-interposition",
    "-fPIC",
    "-shared",
)

_VERSION_TIMEOUT = 30.0  # s
_LINES = 8  # of what the compiler says that go into a message

_ADVICE = (
    f"Name a C compiler that works by the environment variable {VARIABLE} or CC, "
    f"or set {VARIABLE}=none to do without"
)


class CompilerError(RuntimeError):
    """A C compiler that is not there, or does not do its work."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler.

    Attributes
    ----------
    command : tuple of str
        Path of the program, and arguments that always go first.
    version : str
        What it says of itself.
    """

    command: tuple[str, ...]
    version: str

    def build(self, source: str, folder: Path, timeout: float) -> Path:
        """Compile C code to a library and return its path.

        Parameters
        ----------
        source : str
            C code.
        folder : Path
            Where to work: an empty folder that nobody else writes into.
        timeout : float
            Longest time to wait, s.

        Raises
        ------
        CompilerError
            If the compiler fails, writes nothing, or takes longer than that.
        """
        # Names without a folder: the library must not depend on where it was made.
        (folder / "function.c").write_text(source, encoding="utf-8")
        return self.link([Path("function.c")], folder, "function", timeout)

    def link(
        self,
        sources: Sequence[Path],
        folder: Path,
        name: str,
        timeout: float,
        extra: tuple[str, ...] = (),
    ) -> Path:
        """Compile files of C code to one library and return its path.

        Parameters
        ----------
        sources : sequence of Path
            As seen from the folder.
        folder : Path
            Where to work: a folder that nobody else writes into.
        name : str
            Name of the library, without its ending.
        timeout : float
            Longest time to wait, s.
        extra : tuple of str
            Options that go after all others.

        Raises
        ------
        CompilerError
            If the compiler fails, writes nothing, or takes longer than that.
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

    Returns
    -------
    Compiler or None

    Raises
    ------
    CompilerError
        If one of the variables names a program that is not there or does not run.

    Examples
    --------
    >>> import os
    >>> from unittest.mock import patch
    >>> from tenscontrol.dynamics.compiler import compiler
    >>> with patch.dict(os.environ, TENSCONTROL_COMPILER="none"):
    ...     print(compiler())
    None
    """
    if os.getenv(VARIABLE, "").strip().lower() == "none":
        return None
    for variable in (VARIABLE, "CC"):
        asked = os.getenv(variable, "").strip()
        if asked:
            return _asked_for(variable, asked)
    for name in _USUAL:
        path = shutil.which(name)
        version = None if path is None or _is_stub(path) else _version((path,))
        if path is not None and version is not None:
            return Compiler((path,), version)
    return None


def suffix() -> str:
    """Return how the name of a library ends."""
    return ".dll" if os.name == "nt" else ".so"


def _asked_for(variable: str, asked: str) -> Compiler:
    # A path with blanks is a program; "ccache gcc" is a program and an argument.
    words = [asked] if shutil.which(asked) else shlex.split(asked)
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


def _libraries() -> list[str]:
    # An undefined symbol ends the link here; else it would end the program at the first call.
    return ["-lm", "-Wl,--no-undefined"] if sys.platform.startswith("linux") else ["-lm"]


def _run(command: list[str], folder: Path | None, timeout: float) -> tuple[int | None, str]:
    """Return exit status, None if time ran out, and what a program said."""
    environment = {**os.environ, "LC_ALL": "C"}
    if folder is not None:
        environment["TMPDIR"] = str(folder)  # goes with the folder, whatever happens
    with subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        start_new_session=True,
    ) as process:
        try:
            said, _ = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            return None, ""
        finally:
            # Also at Ctrl-C: what the compiler has started must not go on without it.
            if process.returncode is None:
                _end(process)
    return process.returncode, said


def _end(process: subprocess.Popen[str]) -> None:
    if os.name == "nt":
        process.kill()
    else:
        with suppress(ProcessLookupError):  # it may just have ended
            os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
