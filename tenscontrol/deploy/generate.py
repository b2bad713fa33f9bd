"""C code of a controller: one folder that a C compiler builds."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tenscontrol.control import LQR, MPC, NMPC, Controller, FunctionController
from tenscontrol.deploy.code_text import code_files
from tenscontrol.deploy.compiled_controller import CompiledController, compiled
from tenscontrol.deploy.controllers import LawCode, lqr_code, mpc_code, nmpc_code
from tenscontrol.dynamics import builds
from tenscontrol.files import make_folder, write_file
from tenscontrol.plant import LinearPlant
from tenscontrol.validation import FloatArray, file_path, frozen

# Names of functions and headers that a controller may not have.
_TAKEN = {"main", "active_set", "stages", "casadi", "math", "string", "stdio"}


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
        ``"LQR"``, ``"MPC"`` or ``"NMPC"``.
    files : tuple of str
        All files of the folder.
    sizes : tuple of int
        Their sizes, bytes.
    plant : LinearPlant
        What the controller was designed on.
    sample_time : float
        Sample time, s.
    low, high : ndarray, shape (α,)
        Bounds of the commands.
    """

    folder: Path
    name: str
    kind: str
    files: tuple[str, ...]
    sizes: tuple[int, ...]
    plant: LinearPlant
    sample_time: float
    low: FloatArray
    high: FloatArray

    def compile(self, timeout: float = 600.0) -> CompiledController:
        """Compile the code, and return it as a controller for this process.

        Each call returns a controller with its own memory.

        Parameters
        ----------
        timeout : float
            Longest time that the compiler may take, s; at most a day.

        Returns
        -------
        CompiledController

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
        return CompiledController(self.name, library, self.plant, self.sample_time, bounds)

    def __repr__(self) -> str:
        return (
            f"GeneratedController({self.kind} in {str(self.folder)!r}, {len(self.files)} files, "
            f"{sum(self.sizes) / 1024:.0f} kB)"
        )


def generate_c(controller: Controller, folder: object, *, name: str = "controller") -> (
    GeneratedController
):  # fmt: skip
    """Write a controller as C code into a new folder.

    The code is C99, allocates no memory and needs nothing but a C compiler:
    ``cc -O2 *.c -lm`` in the folder builds a program that runs it on samples
    from a file. Its commands agree with those of the controller in Python to round-off, fallbacks
    included, from the state after ``reset()``. See ``README.txt`` in the folder.

    Parameters
    ----------
    controller : LQR, MPC or NMPC
        An LQR must have a sample time. Later changes, ``follow`` in particular, do not
        reach the code.
    folder : path-like
        Is created; must not exist, or be empty.
    name : str
        Prefix of files and functions in C.

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
        strings or ramp inputs, or the reference lasts too long for a table.
    FileExistsError
        If the folder is not empty.
    OSError
        If a file cannot be written: then none is left.

    Notes
    -----
    The quadratic program is solved exactly, by a dual active-set method (Goldfarb & Idnani
    1983, doi:10.1007/BF02591962), condensed for MPC and along the stages of the horizon for
    NMPC, whatever solves it in Python: commands are equal to round-off where that is exact too,
    and to its tolerance otherwise. ``max_iterations`` limits changes of the active set. The
    reduced state is found by code that CasADi generates. A reference that moves is put into a
    table, a row a sample, and time is rounded to a whole sample.

    Examples
    --------
    >>> import tempfile, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    >>> mpc = tc.MPC(plant, horizon=5, sample_time=0.02, max_force_density=60.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     made = tc.generate_c(mpc, folder)
    ...     made.kind, "controller.h" in made.files
    ('MPC', True)
    """
    law = _law_code(controller)
    name = _checked_name(name)
    place = file_path("folder", folder).absolute()
    if os.path.isdir(place) and any(place.iterdir()):
        raise FileExistsError(
            f"folder {str(place)!r} is not empty, and other C files in it would be compiled too: "
            "give a new one"
        )
    texts = code_files(controller, law, name)
    _write_folder(place, texts, last=f"{name}.h")
    assert controller.sample_time is not None  # checked with the law
    low, high = controller.bounds
    listed = sorted(texts)
    return GeneratedController(
        folder=place,
        name=name,
        kind=type(controller).__name__,
        files=tuple(listed),
        sizes=tuple((place / file).stat().st_size for file in listed),
        plant=controller.plant,
        sample_time=controller.sample_time,
        low=frozen(low),
        high=frozen(high),
    )


@builds
def _law_code(controller: object) -> LawCode:
    if isinstance(controller, MPC):
        return mpc_code(controller)
    if isinstance(controller, NMPC):
        return nmpc_code(controller)
    if isinstance(controller, LQR):
        return lqr_code(controller)
    which = (
        f"FunctionController of {controller.label}, which is Python"
        if isinstance(controller, FunctionController)
        else type(controller).__name__
    )
    raise TypeError(
        f"controller is a {which}, expected an LQR with a sample time, an "
        "MPC or an NMPC: only these can be written as C code"
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


def _write_folder(place: Path, texts: dict[str, str], last: str) -> None:
    """Write files, or none; without the last one, which all need, no part of them compiles."""
    missing = [each for each in (place, *place.parents) if not os.path.exists(each)]
    try:
        make_folder(place)
        for file in sorted(texts, key=lambda each: each == last):
            write_file(place / file, texts[file], flush=file == last)
    except BaseException:  # Ctrl-C too
        written = [(place / file).unlink for file in texts]
        for remove in (*written, *(folder.rmdir for folder in missing)):
            with suppress(OSError):
                remove()
        raise
