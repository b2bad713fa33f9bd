"""The state equation of a large scene in C: a loop over the members for each kernel.

The kernels are CasADi's C code for one member; here are the loops around them
and the tables of nodes and parameters they run over. The compiler puts the
kernels into the loops, so that one evaluation costs about what a loop written by
hand costs, and as much a member in a large scene as in a small one.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscontrol.dynamics import driver_text as text
from tenscontrol.dynamics.compiled import compiled_source
from tenscontrol.dynamics.equation import Equation
from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.dynamics.passes import Pass, body_passes, gap_pass, string_pass
from tenscontrol.dynamics.strings import StringLaw
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, frozen

# Entries that each array has for a node or a string.
_WIDTH = {"p": 3, "v": 3, "f": 3, "a": 3, "u": 1, "taut": 1, "gap": 1, "rate": 1}
_WRITTEN = ("f", "a", "gap", "rate")


def driver_equation(structure: Structure, law: StringLaw | None, load: FloatArray) -> Equation:
    """Return the state equation, with the loops over the members in compiled C.

    Its functions have no derivatives.

    Parameters
    ----------
    structure : Structure
    law : StringLaw or None
        None where the force densities are held.
    load : ndarray, shape (3, n)
        Constant forces on the nodes, N.

    Returns
    -------
    Equation

    Raises
    ------
    FileNotFoundError
        If there is no C compiler.
    CompilerError
        If the compiler fails.
    """
    source = driver_source(structure, law, load)
    slope, gap, force = compiled_source(source, ("slope", "gap", "force"))
    return Equation(
        slope=slope,
        gap=gap,
        force=force,
        velocity_dependent=law is not None and law.is_damped,
        structure=structure,
        law=law,
        load=frozen(load) if load.any() else None,
        form="driver",
    )


def driver_source(structure: Structure, law: StringLaw | None, load: FloatArray) -> str:
    """Return the C text: the functions of :class:`Equation` with CasADi's interface.

    Parameters
    ----------
    structure : Structure
    law : StringLaw or None
        None where the force densities are held.
    load : ndarray, shape (3, n)
        Constant forces on the nodes, N.

    Returns
    -------
    str
    """
    strings, bodies = [string_pass(structure, law)], body_passes(structure)
    gaps = [] if law is None else [gap_pass(structure, law)]
    passes = [each for each in [*strings, *bodies, *gaps] if each.count]
    loops = [_Loop(each, structure) for each in passes]
    calls = {loop.over.name: loop.call for loop in loops}
    free, alpha = len(structure.free), len(structure.strings)
    states, switches = 6 * free, 0 if law is None else alpha
    sizes = {"NODES": structure.nodes.shape[1], "FREE": free, "LARGEST": max(states, alpha, 1)}
    tables: dict[str, Any] = {}
    if len(structure.fixed):
        tables["free_nodes"] = 3 * structure.free
        tables["places"] = structure.nodes.ravel(order="F")
    if load.any():
        tables["load"] = load.ravel(order="F")
    kernels = ca.CodeGenerator("kernels", {"with_header": False})
    for loop in loops:
        kernels.add(loop.function)
        tables |= loop.tables

    def called(some: list[Pass]) -> str:
        return "\n".join(f"  {calls[each.name]}" for each in some if each.name in calls)

    return "\n".join(
        [
            text.HEAD,
            kernels.dump(),
            text.EXPORT,
            *(f"#define {name} {size}" for name, size in sizes.items()),
            *(_table(name, values) for name, values in tables.items()),
            text.SUPPORTED if len(structure.fixed) else text.FREE,
            *(loop.text for loop in loops),
            text.FORCES
            % {"start": text.LOADED if load.any() else text.UNLOADED, "calls": called(strings)},
            text.SLOPE % {"calls": called(bodies)},
            text.FORCE_FREE if len(structure.fixed) == 0 else text.FORCE_SUPPORTED,
            text.GAP % {"calls": called(gaps)},
            _interface("slope", [states, alpha, switches], [states]),
            _interface("gap", [states, alpha], [switches, switches]),
            _interface("force", [states // 2, states // 2, alpha, switches], [states // 2]),
        ]
    )


class _Loop:
    """The loop of one pass: its kernel, its tables, its text, and how it is called."""

    def __init__(self, over: Pass, structure: Structure) -> None:
        self.over = over
        self.tables: dict[str, Any] = {}
        # Rows of the accelerations are the free nodes only.
        self._slots = np.zeros(structure.nodes.shape[1], dtype=int)
        self._slots[structure.free] = np.arange(len(structure.free))
        lines = self._kernel_lines()
        lines += [line for write in over.writes for line in self._write(write)]
        arrays = dict.fromkeys([read.array for read in over.reads.values()])
        arrays |= dict.fromkeys([write.array for write in over.writes])
        declared = ", ".join(
            f"{'' if name in _WRITTEN and self._is_written(name) else 'const '}double *{name}"
            for name in arrays
        )
        self.call = f"{over.name}({', '.join(arrays)});"
        body = "\n".join(f"    {line}" for line in lines)
        self.text = text.LOOP % {
            "name": over.name, "arrays": declared, "count": over.count, "body": body
        }  # fmt: skip

    def _is_written(self, array: str) -> bool:
        return any(write.array == array for write in self.over.writes)

    def _kernel_lines(self) -> list[str]:
        """Make the kernel of one member, and return the lines that call it."""
        over = self.over
        inputs = {name: ca.SX.sym(name, _WIDTH[read.array]) for name, read in over.reads.items()}
        shared = {name: ca.DM(v) for name, v in over.parameters.items() if isinstance(v, float)}
        own = {name: ca.SX.sym(name) for name in over.parameters if name not in shared}
        outputs = over.kernel(inputs | shared | own)
        # What depends on parameters only is worked out here, once.
        outputs, constants = _constants(outputs, own, over.parameters)
        lines = []
        for name, read in over.reads.items():
            width = _WIDTH[read.array]
            at = self._at(read.nodes, slots=False, width=width)
            entries = ", ".join(f"{read.array}[{at} + {k}]" for k in range(width))
            lines.append(f"const double in_{name}[{width}] = {{{entries}}};")
        for k, (_, values) in enumerate(constants):
            table = self._add_table(f"constant_{k}", values)
            lines.append(f"const double in_constant_{k}[1] = {{{table}[i]}};")
        lines += [f"double out_{k}[{part.numel()}];" for k, part in enumerate(outputs)]
        names = [*inputs, *(f"constant_{k}" for k in range(len(constants)))]
        lines.append(f"const double *arg[] = {{{', '.join(f'in_{name}' for name in names)}}};")
        lines.append(f"double *res[] = {{{', '.join(f'out_{k}' for k in range(len(outputs)))}}};")
        lines.append(f"kernel_{over.name}(arg, res, 0, 0, 0);")
        symbols = [*inputs.values(), *(symbol for symbol, _ in constants)]
        dense = [ca.densify(part) for part in outputs]
        self.function = ca.Function(f"kernel_{over.name}", symbols, dense)
        return lines

    def _write(self, write: Any) -> list[str]:
        width = _WIDTH[write.array]
        at = self._at(write.nodes, slots=write.array == "a", width=width)
        how = "=" if write.array != "f" else "+=" if write.sign > 0 else "-="
        return [
            f"{write.array}[{at} + {k}] {how} out_{write.output}[{k}];" for k in range(width)
        ]  # fmt: skip

    def _at(self, nodes: Any, slots: bool, width: int) -> str:
        """Return the C expression of where the entries of a member begin."""
        if nodes is None:
            return "i" if width == 1 else f"{width} * i"
        table = self._add_table("at", width * (self._slots[nodes] if slots else nodes))
        return f"{table}[i]"

    def _add_table(self, name: str, values: Any) -> str:
        for known, others in self.tables.items():
            if np.array_equal(others, values):
                return known
        full = f"{self.over.name}_{name}_{len(self.tables)}"
        self.tables[full] = values
        return full


def _constants(
    outputs: tuple[Any, ...], own: dict[str, Any], parameters: dict[str, float | FloatArray]
) -> tuple[tuple[Any, ...], list[tuple[Any, FloatArray]]]:
    """Return the outputs with symbols for what depends on parameters only, and their values."""
    if not own:
        return outputs, []
    stacked, found, expressions = ca.extract_parametric(
        ca.vertcat(*(ca.vec(part) for part in outputs)), ca.vertcat(*own.values())
    )
    # A parameter that stands by itself in the outputs is a constant as it is.
    alone = [symbol for symbol in own.values() if ca.depends_on(stacked, symbol)]
    evaluate = ca.Function("constants", list(own.values()), [*expressions, *alone])
    columns = [np.asarray(parameters[name])[None, :] for name in own]
    values = [row.ravel().copy() for row in evaluate_columns(evaluate, *columns)]
    ends = np.cumsum([0, *(part.numel() for part in outputs)]).tolist()
    split = ca.vertsplit(stacked, ends)
    return tuple(split), list(zip([*found, *alone], values, strict=True))


def _table(name: str, values: Any) -> str:
    kind = "int" if values.dtype.kind == "i" else "double"
    entries = values.tolist()
    lines = [",".join(map(repr, entries[i : i + 16])) for i in range(0, len(entries), 16)]
    return f"static const {kind} {name}[{len(entries)}] = {{\n" + ",\n".join(lines) + "\n};"


def _interface(name: str, inputs: list[int], outputs: list[int]) -> str:
    """Return what CasADi asks about an external function: its arguments, all dense columns."""
    shapes = {"in": inputs, "out": outputs}
    tables = {
        side: ", ".join(f"{{{rows}, 1, 1}}" for rows in sizes) for side, sizes in shapes.items()
    }
    return text.INTERFACE % {
        "name": name,
        "inputs": len(inputs),
        "outputs": len(outputs),
        "shapes_in": tables["in"],
        "shapes_out": tables["out"],
    }
