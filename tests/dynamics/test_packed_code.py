"""C code with roots and quotients side by side finds what CasADi finds, to the last bit."""

import re

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.forms.loops import C_EXPORT, C_HEAD, external_interface
from tenscontrol.dynamics.forms.packed_code import PACKED_HEAD, packed_source
from tenscontrol.dynamics.machine_code import compiled_source, compiler
from tests.random_structures import any_structure

needs_compiler = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


def compiled(function):
    """The function in packed code."""
    types = "#define casadi_int long long int\n#define casadi_real double\n#define WORK 1\n"
    name = function.name()
    sizes_in = [function.size1_in(i) for i in range(function.n_in())]
    sizes_out = [function.size1_out(i) for i in range(function.n_out())]
    call = (
        f"EXPORTED int packed(const double **arg, double **res, casadi_int *iw, double *w, int mem)"
        f" {{ return {name}(arg, res, iw, w, mem); }}"
    )
    interface = external_interface("packed", sizes_in, sizes_out)
    parts = [C_HEAD, types, C_EXPORT, PACKED_HEAD, packed_source(function), call, interface]
    return compiled_source("\n".join(parts), ("packed",))[0]


def equations():
    ball = tc.Model(tc.library.six_bar_ball(), tc.LinearStrings(500.0, damping=2.0), gravity=9.81)
    yield "damped ball", ball.equation(input="rest_length")
    on_ground = tc.Model(
        tc.prism(), tc.LinearStrings(500.0), gravity=9.81, ground=tc.Ground(5e3, friction=0.5)
    )
    yield "prism on the ground", on_ground.equation(input="rest_length")
    planar = tc.Model(tc.library.d_bar(), tc.ElasticStrings(1e3))
    yield "planar D-bar", planar.equation(input="rest_length")
    yield "held forces", tc.Model(tc.library.class2_tower(2)).equation(input="force_density")
    for seed in range(3):
        model = tc.Model(any_structure(seed), tc.LinearStrings(100.0))
        yield f"random {seed}", model.equation(input="rest_length", form="flat")


@needs_compiler
@pytest.mark.parametrize("equation", [pytest.param(each, id=name) for name, each in equations()])
def test_packed_code_has_the_same_bits(equation):
    slope = equation.slope
    found = compiled(slope)
    rng = np.random.default_rng(3)
    for _ in range(5):
        x, u = rng.normal(size=equation.states), rng.uniform(0.1, 2.0, equation.inputs)
        taut = rng.integers(0, 2, equation.switches).astype(float)
        expected = np.array(slope(x, u, taut)).ravel()
        assert np.isfinite(expected).all()
        assert np.array(found(x, u, taut)).ravel().tobytes() == expected.tobytes()


def test_roots_and_quotients_are_in_loops():
    ball = tc.Model(tc.library.six_bar_ball(), tc.LinearStrings(500.0))
    slope = ball.equation(input="rest_length").slope
    of = [slope.instruction_id(k) for k in range(slope.n_instructions())]
    roots, quotients = of.count(ca.OP_SQRT), of.count(ca.OP_DIV)
    assert (roots, quotients) == (24, 36)
    text = packed_source(slope)
    assert text.count("sqrt(") == 1
    loops = [int(size) for size in re.findall(r"for \(int i = 0; i < (\d+);", text)]
    assert sum(loops) == roots + quotients
    assert len(loops) == 4  # lengths, force densities, and two of the bars


def test_what_is_not_arithmetic_is_left_to_casadi():
    x = ca.SX.sym("x", 2)
    assert packed_source(ca.Function("f", [x], [2 / x])) is not None
    assert packed_source(ca.Function("f", [x], [ca.sin(x)])) is None
    assert packed_source(ca.Function("f", [x], [x + ca.inf])) is None
    y = ca.MX.sym("y", 2)
    assert packed_source(ca.Function("f", [y], [y / 2])) is None
    long = x
    for _ in range(2500):
        long = long * x + 1
    assert packed_source(ca.Function("f", [x], [long])) is None
