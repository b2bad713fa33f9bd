"""A generated controller, compiled and run in this process: software in the loop."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import final

import numpy as np

from tenscontrol.analysis import LinearPlant
from tenscontrol.control.controller import BAD_WISH, OK, Controller
from tenscontrol.control.plausible import ABSURD_MEASUREMENT, BAD_MEASUREMENT
from tenscontrol.control.quadratic_program import Status
from tenscontrol.dynamics.compiler import CompilerError, compiler
from tenscontrol.validation import FloatArray, positive_number

# Words for a status of the C code: controller.h.
_REASONS = (
    OK,
    "saturated",
    BAD_MEASUREMENT,
    Status.INACCURATE.value,
    Status.INFEASIBLE.value,
    Status.UNBOUNDED.value,
    Status.OUT_OF_ITERATIONS.value,
    Status.OUT_OF_TIME.value,
    Status.NOT_CONVEX.value,
    Status.INTERRUPTED.value,
    Status.UNSOLVED.value,
    Status.BAD_DATA.value,
    ABSURD_MEASUREMENT,
    BAD_WISH,
)

# GCC takes a third of the time of -O2 for long straight code.
OPTIMIZATION = "-O1"

_FALLBACKS = {
    "LQR": ("", "", "last command held", "equilibrium held"),
    "MPC": ("", "last plan continued", "last command held", "equilibrium held"),
    "NMPC": ("", "plan continued", "last command held", "equilibrium held"),
}


@final
class CompiledController(Controller):
    """The C code of a controller, with the face of any other.

    Give it to :func:`simulate` to run the code itself in the loop. Made by
    :meth:`GeneratedController.compile`.
    """

    def __init__(
        self,
        name: str,
        kind: str,
        sources: Sequence[Path],
        plant: LinearPlant,
        step: float,
        bounds: tuple[FloatArray, FloatArray],
        timeout: float,
    ) -> None:
        super().__init__(plant, step, *bounds)
        timeout = positive_number("timeout", timeout, "s")
        found = compiler()
        if found is None:
            raise FileNotFoundError(
                "there is no C compiler: none of $CC, cc, gcc and clang is on the path, or it is "
                "switched off by TENSCONTROL_COMPILER. The generated code can be compiled elsewhere"
            )
        # A file of its own for each, so that none shares the memory of another. What is loaded
        # stays when the file goes, except on Windows, where the file stays too.
        with TemporaryDirectory(prefix="tenscontrol-", ignore_cleanup_errors=True) as folder:
            library = found.link(sources, Path(folder), f"lib{name}", timeout, (OPTIMIZATION,))
            try:
                loaded = ctypes.CDLL(str(library))
            except OSError as error:
                raise CompilerError(
                    f"the compiled controller cannot be loaded: {error}. The compiler may be one "
                    "for another machine: see CC"
                ) from None
        self._fallbacks = _FALLBACKS[kind]
        numbers = ctypes.POINTER(ctypes.c_double)
        self._reset, self._run, self._tell, self._count = (
            getattr(loaded, f"{name}_{what}")
            for what in ("reset", "command", "applied", "iterations")
        )
        self._run.argtypes = [ctypes.c_double, numbers, numbers, numbers]
        self._tell.argtypes = [numbers]
        self.reset()

    @property
    def iterations(self) -> int:
        """Iterations of the solver in the last sample; 0 where none ran."""
        return int(self._count())

    def reset(self) -> None:
        """Forget everything that was measured, planned or applied."""
        super().reset()
        self._reset()

    def applied(self, value: object) -> None:
        """See :meth:`Controller.applied`."""
        super().applied(value)
        assert self._standing is not None  # just told
        held = np.ascontiguousarray(self._standing)
        self._tell(held.ctypes.data_as(ctypes.POINTER(ctypes.c_double)))

    def take_over(self, command: FloatArray) -> None:
        """See :meth:`Controller.take_over`; an estimated load is forgotten too."""
        self.reset()
        self.applied(command)

    def _perceived(
        self, nodes: FloatArray, velocities: FloatArray
    ) -> tuple[FloatArray, str | None]:
        # The code judges and measures for itself.
        return np.concatenate([nodes.ravel(order="F"), velocities.ravel(order="F")]), None

    def _decide(self, time: float, state: FloatArray) -> tuple[FloatArray, str]:
        command = np.zeros(len(self._low))
        numbers = ctypes.POINTER(ctypes.c_double)
        nodes, velocities = (part.ctypes.data_as(numbers) for part in np.split(state, 2))
        status = self._run(time, nodes, velocities, command.ctypes.data_as(numbers))
        reason, fallback = _REASONS[status & 15], self._fallbacks[status >> 4]
        return command, f"{reason}: {fallback}" if fallback else reason

    def _fall_back(self, reason: str) -> tuple[FloatArray, str]:
        # The code falls back for itself where a measurement is no number, and gives that reason.
        command, status = self._decide(0.0, np.full(2 * self.plant.nodes.size, np.nan))
        return command, status.replace(BAD_MEASUREMENT, reason, 1)

    def __repr__(self) -> str:
        return f"CompiledController({self.plant!r}, every {self.step:g} s)"
