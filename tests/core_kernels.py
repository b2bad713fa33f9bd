"""The kernels of the core: C code of one member, printed from the statement of the physics.

Run: ``python -m tests.core_kernels --write`` after a change of :mod:`tenscontrol.dynamics.kernel`
or of a law. A test prints them anew and compares.
"""

from __future__ import annotations

import re
import sys
import textwrap
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscontrol.dynamics import kernel
from tenscontrol.dynamics.contact_laws import Ground, HertzGround, SmoothGround
from tenscontrol.dynamics.string_laws import ElasticStrings, LinearStrings
from tenscontrol.structure.structure import Structure

_CORE = Path(__file__).parent.parent / "tenscontrol" / "core"
FILE, SLOPES = _CORE / "kernels.h", _CORE / "slopes.h"

_HEAD = """\
/* Kernels of one member: printed by tests/core_kernels.py, not by hand.

   Vectors have as many entries as the name says. Units are SI; signs are those of the module
   tenscontrol.dynamics.kernel: force densities of strings are positive in tension, those of bars
   in compression. */
#ifndef TENSCONTROL_KERNELS_H
#define TENSCONTROL_KERNELS_H

#include "numbers.h"
"""

# The C text of operations, and how tightly it binds: a sum, a product, a sign, a call.
_SUM, _PRODUCT, _SIGN, _WHOLE = range(4)
_OPERATIONS = {
    ca.OP_ASSIGN: ("{0}", _SUM), ca.OP_ADD: ("{0} + {1}", _SUM), ca.OP_SUB: ("{0} - {1}", _SUM),
    ca.OP_MUL: ("{0} * {1}", _PRODUCT), ca.OP_DIV: ("{0} / {1}", _PRODUCT),
    ca.OP_INV: ("1 / {0}", _PRODUCT), ca.OP_NEG: ("-{0}", _SIGN),
    ca.OP_SQ: ("{0} * {0}", _PRODUCT), ca.OP_TWICE: ("2 * {0}", _PRODUCT),
    ca.OP_SQRT: ("root({0})", _WHOLE), ca.OP_FMAX: ("larger({0}, {1})", _WHOLE),
    ca.OP_FMIN: ("smaller({0}, {1})", _WHOLE), ca.OP_LT: ("truth({0} < {1})", _WHOLE),
    ca.OP_LE: ("truth({0} <= {1})", _WHOLE), ca.OP_EQ: ("truth({0} == {1})", _WHOLE),
    ca.OP_AND: ("truth(({0} != 0) & ({1} != 0))", _WHOLE),
    ca.OP_OR: ("truth(({0} != 0) | ({1} != 0))", _WHOLE), ca.OP_NOT: ("truth({0} == 0)", _WHOLE),
    ca.OP_IF_ELSE_ZERO: ("only({0} != 0, {1})", _WHOLE),
    ca.OP_CONSTPOW: ("power({0}, {1})", _WHOLE), ca.OP_POW: ("power({0}, {1})", _WHOLE),
}  # fmt: skip

# Characters of a line, and of a part that stands within another one.
_COLUMNS, _PART = 110, 72


class _Symbol(ca.SX):
    """A parameter that is there: laws leave out what has none."""

    def __bool__(self) -> bool:
        return True


def _symbol(name: str) -> _Symbol:
    return _Symbol(ca.SX.sym(name))


class _Term(NamedTuple):
    text: str
    binds: int = _WHOLE
    is_constant: bool = False

    def within(self, binds: int) -> str:
        return self.text if self.binds >= binds else f"({self.text})"


def printed(name: str, inputs: dict[str, Any], outputs: dict[str, Any]) -> str:
    """Return the C text of a function of numbers and vectors, by name.

    What is used once stands where it is used, in the order of the graph, so to the same bits.
    """
    values = ca.cse([ca.densify(output) for output in outputs.values()])
    function = ca.Function(name, list(inputs.values()), values)
    given = [
        f"const Number {'*' if size > 1 else ''}{key}"
        for key, size in ((key, each.numel()) for key, each in inputs.items())
    ]
    given += [f"Number *{key}" for key in outputs]
    head = f"static inline void {name}({', '.join(given)}) {{"
    steps = [
        (function.instruction_id(k), function.instruction_input(k), function.instruction_output(k))
        for k in range(function.n_instructions())
    ]
    uses, ends = _uses(steps)
    lines, known = list[str](), dict[int, _Term]()
    for k, (op, ins, out) in enumerate(steps):
        if op == ca.OP_CONST:
            text = repr(float(function.instruction_constant(k)))
            known[out[0]] = _Term(text, is_constant=True)
        elif op == ca.OP_INPUT:
            known[out[0]] = _Term(_entry(*list(inputs.items())[ins[0]], ins[1]))
        elif op == ca.OP_OUTPUT:
            entry = _entry(*list(outputs.items())[out[0]], out[1])
            lines.append(f"{'' if '[' in entry else '*'}{entry} = {known[ins[0]].text};")
        else:
            term = _term(op, [known[i] for i in ins])
            if uses[k] > 1 or (k not in ends and len(term.text) > _PART):
                lines.append(f"const Number t{k} = {term.text};")
                term = _Term(f"t{k}")
            known[out[0]] = term
    return "\n".join([_wrapped(head), *(_wrapped(f"  {line}") for line in lines), "}\n"])


def _wrapped(line: str) -> str:
    """Return a line in several if it is long; arguments and products stay whole."""
    whole = re.sub(r" ([*/]) |(?<=const) |(?<=Number) |(?<=\)) (?={)", r"~\1~", line)
    filled = textwrap.fill(whole, _COLUMNS, subsequent_indent=6 * " ", break_long_words=False)
    return re.sub(r"~([*/])~|~~", lambda found: f" {found[1]} " if found[1] else " ", filled)


def _uses(steps: list[tuple[int, list[int], list[int]]]) -> tuple[Counter[int], set[int]]:
    """Return how often the result of each step is used, by its number, and which are returned."""
    uses, ends, last = Counter[int](), set[int](), dict[int, int]()
    for k, (op, ins, out) in enumerate(steps):
        if op != ca.OP_INPUT:
            uses.update(last[i] for i in ins * (2 if op == ca.OP_SQ else 1) if i in last)
        if op == ca.OP_OUTPUT:
            ends.add(last[ins[0]])
        else:
            last[out[0]] = k
    return uses, ends


def _entry(name: str, symbol: Any, place: int) -> str:
    return name if symbol.numel() == 1 else f"{name}[{place}]"


def _term(op: int, operands: list[_Term]) -> _Term:
    text, binds = _OPERATIONS[op]
    if binds == _WHOLE:  # calls convert no constants
        is_choice = op in (ca.OP_FMAX, ca.OP_FMIN)
        parts = [f"all({o.text})" if o.is_constant and is_choice else o.text for o in operands]
    else:
        # C takes equals from the left.
        first = 0 if text.startswith("{0}") else -1
        parts = [o.within(binds + (i != first)) for i, o in enumerate(operands)]
        if op == ca.OP_SQ:
            parts = [operands[0].within(_WHOLE)]
    return _Term(text.format(*parts), binds)


def with_constants(
    name: str, inputs: dict[str, Any], mass: Any, outputs: dict[str, Any]
) -> list[str]:
    """Return the C text of a function, and of one that finds what it needs of the mass, once."""
    expressions = list(outputs.values())
    stacked, found, values = ca.extract_parametric(ca.vertcat(*expressions), mass)
    if ca.depends_on(stacked, mass):
        found, values = [*found, mass], [*values, mass]
    constants = ca.SX.sym("constants", len(found))
    stacked = ca.substitute([stacked], found, ca.vertsplit(constants))[0]
    ends = [0]
    for each in expressions:
        ends.append(ends[-1] + each.numel())
    parts = dict(zip(outputs, ca.vertsplit(stacked, ends), strict=True))
    return [
        f"enum {{ {name.upper()}_CONSTANTS = {len(found)} }};",
        printed(f"{name}_constants", {"mass": mass}, {"constants": ca.vertcat(*values)}),
        printed(name, {**inputs, "constants": constants}, parts),
    ]


def kernels() -> str:
    """Return the header."""
    texts = [_HEAD]
    for d in (2, 3):
        texts += _of_bodies(d) + _of_segments(d) + _of_ground(d)
    texts += _of_presses() + _of_laws()
    return "\n".join([*texts, "#endif\n"])


def _of_bodies(d: int) -> list[str]:
    """Return the bars, whose lengths are driven; where they are constant, the extension is 0."""
    B, Bd, start, end = (ca.SX.sym(name, d) for name in ("B", "Bd", "start", "end"))
    mass, extension = ca.SX.sym("mass"), ca.SX.sym("extension")
    texts, turned = list[str](), {"rate": Bd, "extension": extension}
    *accelerations, free = kernel.free_bar(B, Bd, start, end, mass, extension)
    tip, swinging = kernel.swinging_bar(B, Bd, end, mass, extension)
    for kind, ends, moved, density in (
        (
            "free",
            {"on_start": start, "on_end": end},
            dict(zip(("start", "end"), accelerations, strict=True)),
            free,
        ),
        ("swinging", {"on_tip": end}, {"tip": tip}, swinging),
    ):
        given = {"bar": B} | turned | ends
        texts += with_constants(f"{kind}_bar_{d}", given, mass, moved)
        result = {"force_density": density}
        texts.append(printed(f"{kind}_bar_force_density_{d}", given | {"mass": mass}, result))
    right = {"right": -kernel.turning(Bd, extension)}
    return [*texts, printed(f"coupled_bar_{d}", turned, right)]


def _of_segments(d: int) -> list[str]:
    S, Sd = ca.SX.sym("S", d), ca.SX.sym("Sd", d)
    length, rest = ca.SX.sym("length"), ca.SX.sym("rest")
    return [
        printed(f"pulling_length_{d}", {"segment": S, "rest": rest},
                {"length": kernel.pulling_length(S, rest)}),
        printed(f"length_rate_{d}", {"segment": S, "change": Sd, "length": length},
                {"rate": kernel.length_rate(S, Sd, length)}),
    ]  # fmt: skip


_SLOPES_HEAD = """\
/* Derivatives of the kernels of one member: printed by tests/core_kernels.py, not by hand.

   Jacobians are stored column by column: of what a kernel returns, by what it is given in turn. */
#ifndef TENSCONTROL_SLOPES_H
#define TENSCONTROL_SLOPES_H

#include "numbers.h"
"""


def slopes() -> str:
    """Return the header of derivatives."""
    texts = [_SLOPES_HEAD]
    for d in (2, 3):
        B, Bd, end = (ca.SX.sym(name, d) for name in ("B", "Bd", "end"))
        mass = ca.SX.sym("mass")
        given = {"bar": B, "rate": Bd, "force": end}
        # The sum of the forces moves the centre; their difference turns the bar.
        *_, free = kernel.free_bar(B, Bd, -end / 2, end / 2, mass)
        _, swinging = kernel.swinging_bar(B, Bd, end, mass)
        for name, density in (("free", free), ("swinging", swinging)):
            result = {"force_density": density}
            texts.append(
                _with_slopes(f"{name}_bar_force_density_slopes_{d}", given, {"mass": mass}, result)
            )
        law, given, normal = _contact(d)
        force = {"force": law.resultant(given["press"], normal, given["v"])}
        texts.append(_with_slopes(f"ground_force_slopes_{d}", given, {"normal": normal}, force))
    for name, law, pressing, given in _ground_laws():
        press = {"press": _press(law, pressing, given)}
        texts.append(_with_slopes(f"{name}_press_slopes", given, pressing, press))
    for name, law, given in _string_laws():
        length, rest, rate = (given.get(key, ca.SX.sym(key)) for key in ("length", "rest", "rate"))
        pull = {"force_density": law.taut_force_density(length, rest, rate)}
        texts.append(_with_slopes(f"{name}_force_density_slopes", given, {}, pull))
    return "\n".join([*texts, "#endif\n"])


def _with_slopes(
    name: str, given: dict[str, Any], beside: dict[str, Any], outputs: dict[str, Any]
) -> str:
    """Return the C text of a kernel that returns its derivatives by what is given, too."""
    by = ca.vertcat(*(ca.vec(symbol) for symbol in given.values()))
    jacobian = ca.jacobian(ca.vertcat(*outputs.values()), by)
    return printed(name, given | beside, outputs | {"slopes": ca.vec(jacobian)})


def _bar_energy() -> str:
    """Return the kinetic energy of a bar along one axis."""
    bar = Structure(nodes=np.array([[0.0, 1.0], [0.0, 0.0]]), bars=[[0, 1]], strings=[], bar_mass=1)
    start, end, mass = (ca.SX.sym(name) for name in ("start", "end", "mass"))
    rates = ca.vertcat(ca.horzcat(start, end), ca.SX(1, 2))
    energy = ca.sum2(kernel.dots(rates, kernel.mass_product(bar, rates))) / 2
    given = {"start": start, "end": end, "mass": mass}
    return printed("bar_energy", given, {"energy": mass * energy})


def _of_laws() -> list[str]:
    texts = [_bar_energy()]
    for name, law, given in _string_laws():
        length, rest, rate = (given.get(key, ca.SX.sym(key)) for key in ("length", "rest", "rate"))
        if "rate" not in given:
            stored = {"energy": law.stored_energy(length, rest)}
            texts.append(printed(f"{name.removesuffix('_undamped')}_energy", given, stored))
        pull = {"force_density": law.taut_force_density(length, rest, rate)}
        texts.append(printed(f"{name}_force_density", given, pull))
        if "rate" in given:
            texts.append(printed(f"{name}_gap", given, {"gap": law.gap(length, rest, rate)}))
    return texts


def _string_laws() -> Iterator[tuple[str, Any, dict[str, Any]]]:
    """Yield the laws of strings with symbols for what they depend on, by name."""
    length, rest, rate, stiffness = (ca.SX.sym(n) for n in ("length", "rest", "rate", "stiffness"))
    for name, kind, field in (
        ("linear", LinearStrings, "stiffness"), ("elastic", ElasticStrings, "axial_rigidity"),
    ):  # fmt: skip
        for damping in (None, ca.SX.sym("damping")):
            law = kind(1.0).with_parameters(
                {field: stiffness} | ({} if damping is None else {"damping": damping})
            )
            given = {"length": length, "rest": rest}
            given |= {} if damping is None else {"rate": rate}
            given |= {"stiffness": stiffness}
            given |= {} if damping is None else {"damping": damping}
            yield f"{name}_{'undamped' if damping is None else 'damped'}", law, given


def _ground_laws() -> Iterator[tuple[str, Any, dict[str, Any], dict[str, Any]]]:
    """Yield the laws of contacts by name, with symbols for whether they press and what they need.

    Smooth ground always presses.
    """
    depth, rate = ca.SX.sym("depth"), ca.SX.sym("rate")
    for name, kind in (("linear", Ground), ("hertz", HertzGround), ("smooth", SmoothGround)):
        is_smooth = kind is SmoothGround
        fields = ["stiffness", "damping", *(["width"] if is_smooth else [])]
        law, symbols = _law(kind, fields)
        pressing = {} if is_smooth else {"pressing": ca.SX.sym("pressing")}
        yield name, law, pressing, {"depth": depth, "rate": rate} | symbols


def _law(kind: type, fields: list[str]) -> tuple[Any, dict[str, Any]]:
    """Return a law of contacts that has symbols for these fields alone, with the symbols."""
    law, symbols = object.__new__(kind), {field: _symbol(field) for field in fields}
    for field, symbol in symbols.items():
        object.__setattr__(law, field, symbol)
    return law, symbols


def _press(law: Any, pressing: dict[str, Any], given: dict[str, Any]) -> Any:
    """Return the normal force, of contacts that press."""
    press = law.normal_force(given["depth"], given["rate"])
    return pressing["pressing"] * press if pressing else press


def _contact(d: int) -> tuple[Any, dict[str, Any], Any]:
    """Return a law with friction, what its force depends on, and the normal of the ground."""
    law, symbols = _law(Ground, ["friction", "slip_speed"])
    object.__setattr__(law, "height", 0.0)  # a plane
    given = {"press": ca.SX.sym("press"), "v": ca.SX.sym("v", d)} | symbols
    return law, given, ca.SX.sym("normal", d)


def _of_ground(d: int) -> list[str]:
    law, given, normal = _contact(d)
    x, height = ca.SX.sym("x", d), ca.SX.sym("height")
    depth, rate = height - kernel.dots(normal, x), -kernel.dots(normal, given["v"])
    given["normal"] = normal
    sunk = {"x": x, "v": given["v"], "height": height, "normal": normal}
    force = {"force": law.resultant(given["press"], normal, given["v"])}
    return [
        printed(f"sinking_{d}", sunk, {"depth": depth, "rate": rate}),
        printed(f"ground_force_{d}", given, force),
    ]


def _of_presses() -> list[str]:
    texts = []
    for name, law, pressing, given in _ground_laws():
        press = {"press": _press(law, pressing, given)}
        texts.append(printed(f"{name}_press", given | pressing, press))
        if name == "linear":  # that of hertz is the same
            gap = {"gap": law.gap(given["depth"], given["rate"])}
            texts.append(
                printed("ground_gap", {k: given[k] for k in ("depth", "rate", "damping")}, gap)
            )
    return texts


COEFFICIENTS = _CORE / "dop853_coefficients.h"


def coefficients() -> str:
    """Return the header of the coefficients of DOP853, and of DOPRI5 as SciPy has them."""
    from scipy.integrate import RK45

    from tenscontrol.integrate import dop853_coefficients as order8
    from tenscontrol.integrate.dop853 import _interpolant_error

    def sums(name: str, weights: Any) -> str:
        terms = " + ".join(f"K[{k} * n + i] * {float(a)!r}" for k, a in enumerate(weights) if a)
        return f"#define {name} ({terms})"

    lines = [
        "/* Coefficients of DOP853 (Hairer, Norsett, Wanner), II.5 and II.6: printed by",
        "   tests/core_kernels.py. Sums of the slopes K of stages, entry i of n. */",
    ]
    for k, (a, c) in enumerate(zip(order8.A[1:], order8.C[1:], strict=True), 1):
        lines += [sums(f"STAGE_{k}", a), f"#define TIME_{k} {float(c)!r}"]
    for k, (a, c) in enumerate(zip(order8.A_EXTRA, order8.C_EXTRA, strict=True), len(order8.B) + 1):
        lines += [sums(f"STAGE_{k}", a), f"#define TIME_{k} {float(c)!r}"]
    lines += [sums("END", order8.B), sums("FIFTH", order8.E5), sums("THIRD", order8.E3)]
    lines += [sums(f"DENSE_{k}", d) for k, d in enumerate(order8.D)]
    share = ", ".join(repr(float(a)) for a in _interpolant_error())
    lines.append("/* What the interpolant errs at a part of a step, over the error estimate. */")
    lines.append(f"static const double INTERPOLANT_ERROR[] = {{{share}}};")
    lines.append(
        "/* Those of DOPRI5, II.5: a step of order 5, with the slope at its end for its error. */"
    )
    for k, (a, c) in enumerate(zip(RK45.A[1:], RK45.C[1:], strict=True), 1):
        lines += [sums(f"SHORT_STAGE_{k}", a), f"#define SHORT_TIME_{k} {float(c)!r}"]
    lines += [sums("SHORT_END", RK45.B), sums("SHORT_ERROR", RK45.E)]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the kernels, or say whether those in the package are up to date."""
    if sys.argv[1:] == ["--write"]:
        FILE.write_text(kernels(), encoding="utf-8")
        SLOPES.write_text(slopes(), encoding="utf-8")
        COEFFICIENTS.write_text(coefficients(), encoding="utf-8")
    else:
        print("up to date" if FILE.read_text("utf-8") == kernels() else "run it with --write")


if __name__ == "__main__":
    main()
