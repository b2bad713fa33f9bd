"""C code of a controller: one folder that a C compiler builds."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import Actuation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.controller import Controller
from tenscontrol.control.function_controller import FunctionController
from tenscontrol.control.lqr import LQR
from tenscontrol.control.mpc.linear import MPC
from tenscontrol.control.mpc.nonlinear import NMPC
from tenscontrol.deploy.code_interface import interface_of, interface_of_gait
from tenscontrol.deploy.code_text import code_files
from tenscontrol.deploy.compiled_controller import CompiledController, CompiledGait, compiled
from tenscontrol.deploy.controllers import LawCode, lqr_code, mpc_code, nmpc_code
from tenscontrol.deploy.filter_code import with_filter
from tenscontrol.deploy.gait_code import gait_code
from tenscontrol.deploy.memory_use import MemoryUse, memory_use
from tenscontrol.dynamics.evaluator import builds
from tenscontrol.estimation.kalman_filter import KalmanFilter
from tenscontrol.files import make_folder, read_file, write_file
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.shape.rolling import RollingGait
from tenscontrol.structure.structure import Structure

# Names of functions and headers that a controller may not have.
_TAKEN = {"main", "active_set", "stages", "casadi", "math", "string", "stdio"}

# Lists the other files with their checksums, for `sha256sum -c`, and for a later call, which
# replaces those that are as they were written.
_LIST = "SHA256SUMS"
_HEAD = "# Written by generate_c of tenscontrol, which replaces these files if they are unchanged."
_LINE = re.compile(r"([0-9a-f]{64})  (\w+\.\w+)")
_MOST_BYTES = 2**30


@dataclass(frozen=True, eq=False)
class GeneratedController:
    """A controller as C code. Made by :func:`generate_c`.

    Attributes
    ----------
    folder : Path
        Where the code is.
    name : str
        Prefix of its functions.
    kind : str
        ``"LQR"``, ``"MPC"``, ``"NMPC"`` or ``"RollingGait"``.
    files : tuple of str
        All files of the folder.
    sizes : tuple of int
        Their sizes, bytes.
    structure : Structure
        Whose nodes it is given.
    actuation : Actuation
        Which strings its commands move.
    plant : LinearPlant or None
        What the controller was designed on; None for a gait.
    sample_time : float
        Sample time, s.
    low, high : ndarray, shape (m,)
        Bounds of the commands, one for each input of the plant.
    """

    folder: Path
    name: str
    kind: str
    files: tuple[str, ...]
    sizes: tuple[int, ...]
    structure: Structure
    actuation: Actuation
    plant: LinearPlant | None
    sample_time: float
    low: FloatArray
    high: FloatArray

    def compile(self, timeout: float = 600.0) -> CompiledController | CompiledGait:
        """Compile the code, and return it as a controller for this process.

        Each call returns a controller with its own memory.

        Parameters
        ----------
        timeout : float
            Longest time that the compiler may take, s; at most a day.

        Returns
        -------
        CompiledController or CompiledGait

        Raises
        ------
        FileNotFoundError
            If there is no C compiler, or it is switched off by ``TENSCONTROL_COMPILER=none``.
        CompilerError
            If the compiler fails, or its library cannot be loaded.
        ValueError
            If the timeout is not positive, or longer than a day.
        """
        sources = [file for file in self.files if file.endswith(".c") and file != "main.c"]
        library = compiled(self.name, [self.folder / file for file in sources], timeout)
        bounds = self.low, self.high
        if self.plant is None:
            return CompiledGait(
                self.name, library, self.structure, self.actuation, self.sample_time, bounds
            )
        return CompiledController(self.name, library, self.plant, self.sample_time, bounds)

    def memory(
        self, compiler: str = "cc", options: Sequence[str] = ("-Os",), timeout: float = 600.0
    ) -> MemoryUse:
        """Compile the code for a machine, and return what it takes there.

        Parameters
        ----------
        compiler : str
            Name or path of a compiler like GCC's; ``size`` and ``nm`` are taken from beside it,
            with its prefix: ``"arm-none-eabi-gcc"``.
        options : sequence of str
            Of the compiler, ``("-Os", "-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16",
            "-mfloat-abi=hard")`` for a Cortex-M4F. Warnings are errors.
        timeout : float
            Longest time that the compiler may take for a file, s; at most a day.

        Returns
        -------
        MemoryUse

        Raises
        ------
        FileNotFoundError
            If there is no such compiler, or no ``size`` or ``nm`` for it.
        CompilerError
            If the compiler fails, or warns.
        TypeError, ValueError
            If an argument does not fit.
        """
        compiler = validation.text("compiler", compiler, "the name of a compiler")
        timeout = validation.positive_number("timeout", timeout, "s", validation.LONGEST_WAIT)
        sources = [file for file in self.files if file.endswith(".c") and file != "main.c"]
        return memory_use(compiler, [self.folder / file for file in sources], options, timeout)

    def __repr__(self) -> str:
        return (
            f"GeneratedController({self.kind} in {str(self.folder)!r}, {len(self.files)} files, "
            f"{sum(self.sizes) / 1024:.0f} kB)"
        )


def generate_c(
    controller: Controller | RollingGait,
    folder: object,
    *,
    estimator: KalmanFilter | None = None,
    name: str = "controller",
    overwrite: bool = False,
) -> GeneratedController:
    """Write a controller as C code into a folder of its own.

    The code is C99, allocates no memory and needs nothing but a C compiler:
    ``cc -O2 *.c -lm`` in the folder builds a program that runs it on samples
    from a file. Its commands agree with those of the controller in Python to round-off, fallbacks
    included, from the state after ``reset()``. See ``README.txt`` in the folder.

    Parameters
    ----------
    controller : LQR, MPC, NMPC or RollingGait
        An LQR must have a sample time, and a gait be ``tabulated``. Later changes, ``follow`` in
        particular, do not reach the code.
    folder : path-like
        Is created, or empty, or one that an earlier call wrote: its files are replaced, unless
        they were changed since. Other files there stay.
    estimator : KalmanFilter, optional
        Goes into the code as well: readings in, estimated motion out. It starts as newly made.
    name : str
        Prefix of files and functions in C.
    overwrite : bool
        Whether files of these names are replaced whatever is in them, and those of an earlier call
        even if they were changed. Another C file is refused all the same.

    Returns
    -------
    GeneratedController

    Raises
    ------
    TypeError
        If the controller is of another kind, which cannot be written as C code, or ``folder``
        is no path.
    ValueError
        If an argument does not fit, the controller has a ``time_limit``, an NMPC predicts stiff
        strings or ramp inputs, a gait plans while it runs or its estimator does not roll, or the
        reference lasts too long for a table.
    FileExistsError
        If the folder has a file that was changed, another C file, or no file of an earlier call.
    OSError
        If a file cannot be written: then none is left.

    Notes
    -----
    The quadratic program is solved exactly, by a dual active-set method (Goldfarb & Idnani
    1983, doi:10.1007/BF02591962) along the stages of the horizon, with the C sources of the
    compiled core. Commands are equal to round-off to those of ``solver="stages"``, and to the
    tolerance to those of another solver. ``max_iterations`` limits changes of the active set.
    A command has a number an input of the plant: of strings that share a winch one, of passive
    strings none. The header lists them.
    The reduced state is found by code that CasADi generates. A reference that moves is put into
    a table, a row a sample, and time is rounded to a whole sample.

    Examples
    --------
    >>> import tempfile, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> mpc = tc.MPC(plant, horizon=5, sample_time=0.02, max_force_density=60.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     made = tc.generate_c(mpc, folder)
    ...     made.kind, "controller.h" in made.files
    ('MPC', True)
    """
    law = _law_code(controller)
    name = _checked_name(name)
    path = validation.file_path("folder", folder).absolute()
    if isinstance(controller, RollingGait):
        interface = interface_of_gait(controller)
    else:
        interface = interface_of(controller)
    if estimator is not None:
        law = with_filter(law, interface, estimator)
        if isinstance(controller, RollingGait):
            _refuse_lost_down(controller, estimator)
    texts = code_files(interface, law, name, estimator)
    sums = [f"{_checksum(text.encode())}  {file}" for file, text in texts.items()]
    texts[_LIST] = "\n".join([_HEAD, *sums, ""])
    overwrite = validation.truth("overwrite", overwrite, "whether to replace changed files")
    for file in _replaced(path, set(texts), overwrite):
        (path / file).unlink()
    _write_folder(path, texts, last=f"{name}.h")
    low, high = interface.bounds
    listed = sorted(texts)
    return GeneratedController(
        folder=path,
        name=name,
        kind=interface.kind,
        files=tuple(listed),
        sizes=tuple((path / file).stat().st_size for file in listed),
        structure=interface.structure,
        actuation=interface.actuation,
        plant=interface.plant,
        sample_time=interface.sample_time,
        low=frozen(low),
        high=frozen(high),
    )


def _refuse_lost_down(gait: RollingGait, estimator: KalmanFilter) -> None:
    """Refuse a filter that does not tell a gait which way is down."""
    frame = estimator.design.frame
    if frame is None:
        raise ValueError(
            "estimator lays the shape over that of its operating point, but a gait must know which "
            "way is down: make it by KalmanFilter(..., rolling=True)"
        )
    if not np.allclose(frame.up, gait.settings.up):
        raise ValueError(
            f"estimator has up along {frame.up}, by the gravity of its sensors, but the gait along "
            f"{gait.settings.up}: give both the same gravity"
        )


@builds
def _law_code(controller: object) -> LawCode:
    if isinstance(controller, MPC):
        return mpc_code(controller)
    if isinstance(controller, NMPC):
        return nmpc_code(controller)
    if isinstance(controller, LQR):
        return lqr_code(controller)
    if isinstance(controller, RollingGait):
        return gait_code(controller)
    which = (
        f"FunctionController of {controller.label}, which is Python"
        if isinstance(controller, FunctionController)
        else type(controller).__name__
    )
    raise TypeError(
        f"controller is a {which}, expected an LQR with a sample time, an "
        "MPC, an NMPC or a RollingGait: only these can be written as C code"
    )


def _checked_name(name: object) -> str:
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,30}", name):
        raise ValueError(
            f"name is {name!r}, expected a letter, then letters, digits and _, 31 at most: "
            "C names begin with it"
        )
    if name.lower() in _TAKEN:
        raise ValueError(f"name is {name!r}, which is reserved; give another")
    return name


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _replaced(path: Path, files: set[str], overwrite: bool) -> list[str]:
    """Return the files in a folder that make way; raise if others are in the way."""
    present = {entry.name for entry in path.iterdir()} if os.path.isdir(path) else set()
    known: dict[str, str] = {}
    if _LIST in present:
        text = read_file(path / _LIST, _MOST_BYTES).decode(errors="replace")
        head, *lines = text.splitlines() or [""]
        if head == _HEAD:
            known = {match[2]: match[1] for match in map(_LINE.fullmatch, lines) if match}
    if present and not known and not overwrite:
        raise FileExistsError(
            f"folder {str(path)!r} is not empty, and other C files in it would be compiled too: "
            "give a new one, or overwrite=True"
        )
    ours = present & known.keys()
    if overwrite:
        ours |= present & files
        changed = []
    else:
        changed = sorted(
            file for file in ours if _checksum(read_file(path / file, _MOST_BYTES)) != known[file]
        )
    others = present - ours - {_LIST}
    changed += sorted(file for file in others if file in files or file.endswith((".c", ".h")))
    if changed:
        advice = "" if overwrite or changed[0] in others else ", give overwrite=True"
        raise FileExistsError(
            f"folder {str(path)!r} has {changed[0]!r}, which is not as an earlier call wrote it, "
            f"and would be replaced or compiled too: move it away{advice}, or give a new folder"
        )
    return sorted(ours | (present & {_LIST}))


def _write_folder(path: Path, texts: dict[str, str], last: str) -> None:
    """Write files, or none; without the last one, which all need, no part of them compiles."""
    missing = [above for above in (path, *path.parents) if not os.path.exists(above)]
    try:
        make_folder(path)
        for file in sorted(texts, key=lambda file: file == last):
            write_file(path / file, texts[file], flush=file == last)
    except BaseException:  # Ctrl-C too
        written = [(path / file).unlink for file in texts]
        for remove in (*written, *(folder.rmdir for folder in missing)):
            with suppress(OSError):
                remove()
        raise
