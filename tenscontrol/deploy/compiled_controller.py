"""Generated controllers that run in this process."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, final

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import Actuation
from tenscontrol.arrays import FloatArray
from tenscontrol.control.command import Command
from tenscontrol.control.controller import BaseController, Controller
from tenscontrol.deploy.code_text import status_and_fallback
from tenscontrol.dynamics.machine_code import CompilerError, compiler, link
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.properties import cached_property
from tenscontrol.status import Status
from tenscontrol.structure.structure import Structure

_VECTOR = np.ctypeslib.ndpointer(np.float64, flags="C")

# GCC takes a third of the time of -O2 for long straight code.
OPTIMIZATION = "-O1"


class _LoadedCode:
    """The functions of the library of a generated controller, with their own memory."""

    def __init__(self, name: str, library: bytes) -> None:
        # One file for each, so that none shares the memory of another. A loaded library stays when
        # its file is deleted, except on Windows, where the file stays too.
        with TemporaryDirectory(prefix="tenscontrol-", ignore_cleanup_errors=True) as folder:
            file = Path(folder) / f"lib{name}.so"  # loaded by this name everywhere
            file.write_bytes(library)
            try:
                loaded = ctypes.CDLL(str(file))
            except OSError as error:
                raise CompilerError(
                    f"the compiled controller cannot be loaded: {error}. The compiler may be one "
                    "for another machine: see CC"
                ) from None
        self.reset, self.run, self.set_applied, self.count = (
            getattr(loaded, f"{name}_{function}")
            for function in ("reset", "command", "applied", "iterations")
        )
        self.run.argtypes = [ctypes.c_double, _VECTOR, _VECTOR, _VECTOR]
        self.set_applied.argtypes = [_VECTOR]

    def command(self, time: float, motion: FloatArray, count: int) -> Command:
        """Return what the code commands at a motion, positions and then velocities."""
        command = np.zeros(count)
        number = self.run(time, *np.split(motion, 2), command)
        return Command(command, *status_and_fallback(number))

    def fall_back(self, status: Status, numbers: int, count: int) -> Command:
        """Return the fallback: that of the code for a measurement that is not finite."""
        return replace(self.command(0.0, np.full(numbers, np.nan), count), status=status)


class _RunByCode(BaseController):
    """A controller whose loaded code checks, measures and decides for itself."""

    _code: _LoadedCode

    def reset(self) -> None:
        """Forget everything that was measured, planned or applied."""
        super().reset()
        self._code.reset()

    def applied(self, value: object) -> None:
        """See :meth:`BaseController.applied`."""
        super().applied(value)
        assert self._previous_input is not None  # just set
        self._code.set_applied(np.ascontiguousarray(self._previous_input))

    def _measure(
        self, nodes: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, Status | None]:
        return np.concatenate([nodes.ravel(order="F"), velocities.ravel(order="F")]), None

    def _decide(self, time: float, state: FloatArray) -> Command:
        return self._code.command(time, state, len(self._low))

    def _fall_back(self, status: Status) -> Command:
        return self._code.fall_back(status, 2 * self.structure.nodes.size, len(self._low))


@final
class CompiledController(_RunByCode, Controller):
    """The compiled C code of a controller, used like any other controller.

    Give it to :func:`simulate` to run the code itself in the loop. Made by
    :meth:`GeneratedController.compile`.
    """

    def __init__(
        self,
        name: str,
        library: bytes,
        plant: LinearPlant,
        sample_time: float,
        bounds: tuple[FloatArray, FloatArray],
    ) -> None:
        super().__init__(plant, sample_time, *bounds)
        self._made_of = name, library, plant, sample_time, bounds
        self._code = _LoadedCode(name, library)
        #: Addresses of the functions ``reset`` and ``command`` in C, for loops of compiled code.
        self.entry_points = tuple(
            ctypes.cast(function, ctypes.c_void_p).value or 0
            for function in (self._code.reset, self._code.run)
        )
        self.reset()

    def another(self) -> CompiledController:
        """Return a controller of the same code with a memory of its own; nothing is compiled."""
        return CompiledController(*self._made_of)

    def twin(self) -> CompiledController:
        """See :meth:`Controller.twin`; it is the same each time, as a library is never unloaded."""
        return self._twin

    @cached_property
    def _twin(self) -> CompiledController:
        return self.another()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the compiled code, for processes of like machines; what it remembers stays."""
        return CompiledController, self._made_of

    @property
    def iterations(self) -> int:
        """Iterations of the solver in the last sample; 0 where none ran."""
        return int(self._code.count())

    def __repr__(self) -> str:
        return f"CompiledController({self.plant!r}, every {self.sample_time:g} s)"


@final
class CompiledGait(_RunByCode):
    """The compiled C code of a rolling gait, used like any other controller.

    Give it to :func:`simulate` to run the code itself in the loop. Made by
    :meth:`GeneratedController.compile`.
    """

    def __init__(
        self,
        name: str,
        library: bytes,
        structure: Structure,
        actuation: Actuation,
        sample_time: float,
        bounds: tuple[FloatArray, FloatArray],
    ) -> None:
        self._of_strings = actuation
        super().__init__(structure, "rest_length", sample_time, *bounds)
        self._made_of = name, library, structure, actuation, sample_time, bounds
        self._code = _LoadedCode(name, library)
        self.reset()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the compiled code, for processes of like machines; what it remembers stays."""
        return CompiledGait, self._made_of

    def _driven(self) -> Actuation:
        return self._of_strings

    def __repr__(self) -> str:
        return f"CompiledGait({self.structure!r}, every {self.sample_time:g} s)"


def compiled(name: str, sources: Sequence[Path], timeout: float) -> bytes:
    """Return the library of some C files; see :meth:`GeneratedController.compile`."""
    timeout = validation.positive_number("timeout", timeout, "s", validation.LONGEST_WAIT)
    command = compiler()
    if command is None:
        raise FileNotFoundError(
            "there is no C compiler: none of $CC, cc, gcc and clang is on the path, or it is "
            "switched off by TENSCONTROL_COMPILER. The generated code can be compiled elsewhere"
        )
    with TemporaryDirectory(prefix="tenscontrol-") as folder:
        library = Path(folder) / f"lib{name}.so"
        link(command, sources, library, timeout, [OPTIMIZATION])
        return library.read_bytes()
