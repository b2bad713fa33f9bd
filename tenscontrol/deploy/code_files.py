"""The files of a generated controller."""

from __future__ import annotations

import os
from importlib.metadata import distribution
from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as ca
import numpy as np

from tenscontrol.control import Controller
from tenscontrol.control.mpc import OSQPSolver
from tenscontrol.deploy import c_text
from tenscontrol.deploy.measurement import measurement
from tenscontrol.deploy.parts import Parts

_UNIT = {"force_density": "force densities, N/m", "rest_length": "rest lengths, m"}

_SOLVER_WORDS = """
The quadratic program is solved by OSQP, in controller_qp_workspace.c and the other files. It is
under the licence in OSQP_LICENSE.txt, which has to go with it.
"""


def code_files(controller: Controller, parts: Parts, name: str) -> dict[str, str]:
    """Return the texts of all files, by name.

    Parameters
    ----------
    controller : Controller
    parts : Parts
        Of its law.
    name : str
        What names begin with.

    Raises
    ------
    ValueError
        If the solver has a file of this name.
    """
    plant = controller.plant
    functions = _named({"measure": measurement(plant)} | parts.functions, name)
    count = len(controller.bounds[0])
    sizes = {
        f"{name.upper()}_COORDINATES": plant.nodes.size,
        f"{name.upper()}_COMMANDS": count,
    }
    words = {
        "UNIT": _UNIT[controller.input],
        "SIZES": c_text.constants(sizes)
        + f"\n#define {name.upper()}_STEP {controller.sample_time!r} /* sample time, s */",
        "NODES": str(plant.nodes.shape[1]),
        "COMMANDS": str(count),
        "STEP": f"{controller.sample_time:g}",
        "KIND": type(controller).__name__,
        "SOLVER": "" if parts.program is None else _SOLVER_WORDS.replace("controller", name),
    }
    code = "".join(
        c_text.template(file, name, {}) for file in ("head.c", *parts.templates, "face.c")
    )
    texts = {
        f"{name}.h": c_text.template("controller.h", name, words),
        f"{name}.c": code,
        f"{name}_data.h": _data(controller, parts, functions),
        "main.c": c_text.template("main.c", name, {}),
        "README.txt": c_text.template("README.txt", name, words),
        **_casadi(functions, name),
    }
    return texts if parts.program is None else texts | _solver(parts.program, name, set(texts))


def _named(functions: dict[str, ca.Function], name: str) -> list[ca.Function]:
    """Return functions under the names that they have in C."""
    found = []
    for what, function in functions.items():
        symbols = [ca.MX.sym(f"x{i}", *function.size_in(i)) for i in range(function.n_in())]
        found.append(ca.Function(f"{name}_{what}", symbols, function.call(symbols)))
    return found


def _data(controller: Controller, parts: Parts, functions: list[ca.Function]) -> str:
    """Return the header of all numbers."""
    low, high = controller.bounds
    # Every function by CasADi finds room enough.
    room = {
        f"CASADI_{what.upper()}": max(1, *(getattr(each, f"sz_{what}")() for each in functions))
        for what in ("arg", "res", "iw", "w")
    }
    change, plausible = controller.largest_change, controller.plausible
    constants: dict[str, float | int] = {
        "STATES": 2 * controller.plant.degrees_of_freedom,
        "HOLDS_LAST": int(controller.input == "rest_length"),
        "BARS": plausible.bars.shape[1],
        "FIXED": len(plausible.fixed),
        "FARTHEST": float(plausible.farthest),
        "SPREAD": float(plausible.spread),
        "FASTEST": float(plausible.fastest),
        "FASTEST_SEEN": float(plausible.fastest_seen),
        "OFF": float(plausible.off),
        **room,
        **parts.constants,
    }
    arrays: dict[str, np.ndarray] = {
        "low": low,
        "high": high,
        "change": np.full(len(low), np.inf) if change is None else change,
        "equilibrium": controller.plant.equilibrium_input,
        "bar_start": plausible.bars[0],
        "bar_end": plausible.bars[1],
        "shortest_square": plausible.squares[0],
        "longest_square": plausible.squares[1],
        "fixed_node": plausible.fixed,
        "place": plausible.places.ravel(order="F"),
        **parts.arrays,
    }
    if parts.table is not None:
        first, table = parts.table
        varying = np.flatnonzero((table != table[0]).any(axis=0))
        arrays["first_row"] = table[0]
        constants |= {"ROW_LENGTH": table.shape[1], "VARYING": len(varying)}
        if len(varying):
            arrays |= {"varying": varying, "table": table[:, varying]}
            constants |= {"FIRST_SAMPLE": first, "LAST_SAMPLE": first + len(table) - 1}
    return "\n".join(
        [
            "/* Numbers of the controller. Included once. */",
            c_text.constants(constants),
            "",
            "typedef struct {",
            "    int rows;",
            "    const int *start, *column; /* of the entries of each row */",
            "    const double *value;",
            "} Matrix;",
            "",
            *(c_text.array(name, values) for name, values in arrays.items()),
            *(c_text.matrix(name, values) for name, values in parts.matrices.items()),
            "",
        ]
    )


def _casadi(functions: list[ca.Function], name: str) -> dict[str, str]:
    """Return the files that CasADi writes."""
    code = ca.CodeGenerator(f"{name}_casadi", {"with_header": True})
    for function in functions:
        code.add(function)
    with TemporaryDirectory(prefix="tenscontrol-") as folder:
        code.generate(folder + os.sep)
        return {path.name: path.read_text("utf-8") for path in Path(folder).iterdir()}


def _solver(program: OSQPSolver, name: str, others: set[str]) -> dict[str, str]:
    """Return the files of OSQP, all side by side."""
    with TemporaryDirectory(prefix="tenscontrol-") as folder:
        inside = Path(folder) / "osqp"
        program.write_c(str(inside), f"{name}_qp_")
        found = [path for path in inside.rglob("*.[ch]") if path.name != "emosqp.c"]
        texts = {path.name: path.read_text("utf-8") for path in found}
    clash = sorted(others & set(texts))
    if clash:
        raise ValueError(f"name is {name!r}, but OSQP has a file {clash[0]!r}; give another")
    return texts | {"OSQP_LICENSE.txt": _licence()}


def _licence() -> str:
    """Return the licence of OSQP, which has to go with its code."""
    for path in distribution("osqp").files or []:
        if path.name == "LICENSE":
            return path.read_text("utf-8")
    raise FileNotFoundError(
        "the installed package osqp has no file LICENSE, which has to go with its code: "
        "install osqp from PyPI"
    )
