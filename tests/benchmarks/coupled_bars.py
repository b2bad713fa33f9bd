"""Bars that share nodes under every method: orders through slack switches, and what stays.

``python -m tests.benchmarks.coupled_bars [--duration 20]``: a class-2 tower with slack switches,
its order under each method against DOP853 at a tolerance of 1e-13; a free rhombus of four bars (a
D-bar) in the plane, its energy and momenta under each method; and a double pendulum against the
equations of its two angles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.integrate.methods import METHODS
from tests.benchmarks.command_line import options
from tests.integrate.coupled_scenes import d_bar, moving, tower
from tests.integrate.stepping import fitted_order
from tests.integrate.test_coupled import double_pendulum, double_pendulum_angles

STIFFNESS, GRAVITY, SPAN = 100.0, 2.0, 0.6
STEPS = {
    "rk4": [8e-3, 4e-3, 2e-3, 1e-3],
    "energy_momentum": [4e-3, 2e-3, 1e-3, 5e-4],
}
TOLERANCES = [1e-8, 1e-9, 1e-10, 1e-11, 1e-12]  # long steps err less than their order says


def orders() -> None:
    """Print the errors at the end, and the order fitted to them."""
    structure = tower()
    model = tc.Model(structure, strings=tc.LinearStrings(STIFFNESS), gravity=GRAVITY)
    equation, lengths = model.equation("rest_length"), structure.string_length()
    x = moving(structure)
    exact = METHODS["dop853"].integrator(equation, 1e-13).advance(x, lengths, SPAN, 1)
    switches = exact.work.switches
    print(f"class-2 tower, {SPAN:g} s, {switches} switches: largest error of the state")
    for method, values in STEPS.items():
        integrators = [METHODS[method].integrator(equation, value) for value in values]
        spans = [integrator.advance(x, lengths, SPAN, 1) for integrator in integrators]
        _print_order(method, values, [np.abs(s.states - exact.states).max() for s in spans])
    # Switches cut the steps of DOP853, whose mean tells the order where there are none.
    equation, gamma = model.equation("force_density"), np.full(len(lengths), 20.0)
    tightest = METHODS["dop853"].integrator(equation, 1e-13).advance(x, gamma, 3.0, 1)
    spans = [
        METHODS["dop853"].integrator(equation, t).advance(x, gamma, 3.0, 1) for t in TOLERANCES
    ]
    errors = [np.abs(span.states - tightest.states).max() for span in spans]
    _print_order("dop853, no slack", [3.0 / span.work.steps for span in spans], errors)


def _print_order(method: str, steps: Sequence[float], errors: Sequence[float]) -> None:
    text = " ".join(f"{error:.1e}" for error in errors)
    print(f"  {method:16s} order {fitted_order(steps, errors):4.1f}   {text}")


def invariants(duration: float) -> None:
    """Print changes of energy and momenta of a free structure."""
    structure = d_bar()
    model = tc.Model(structure, strings=tc.LinearStrings(STIFFNESS))
    equation, lengths = model.equation("rest_length"), structure.string_length()
    x = moving(structure)
    print(
        f"\nfree D-bar, {duration:g} s: change of energy (of kinetic), momentum, angular momentum"
    )
    for method, settings in METHODS.items():
        value = 5e-3 if settings.setting == "step" else 1e-9
        span = METHODS[method].integrator(equation, value).advance(x, lengths, duration, 200)
        states = np.column_stack([x, span.states])
        linear, angular = (np.ptp(part, axis=1).max() for part in evaluate_columns(
            model.momentum, states))  # fmt: skip
        energy = _energy(model, lengths, x, span.states)
        print(f"  {method:16s} {energy:.1e}  {linear:.1e} kg m/s  {angular:.1e} kg m²/s")


def _energy(model: tc.Model, lengths: np.ndarray, x: np.ndarray, states: np.ndarray) -> float:
    """Return the largest change of the energy, as part of the largest kinetic energy."""
    states = np.column_stack([x, states])
    inputs = np.tile(lengths[:, None], (1, states.shape[1]))
    kinetic = evaluate_columns(model.kinetic_energy, states)[0]
    energy = kinetic + evaluate_columns(model.elastic_energy, states, inputs)[0]
    return float(np.abs(energy - energy[:, :1]).max() / kinetic.max())


def pendulum() -> None:
    """Print the error of a double pendulum after 5 s."""
    structure = double_pendulum()
    equation = tc.Model(structure, gravity=9.8).equation("force_density")
    x = pack_state(structure, structure.nodes, np.zeros((2, 3)))
    a, b = double_pendulum_angles(5.0)
    tip = [np.sin(a), -np.cos(a), np.sin(a) + np.sin(b), -np.cos(a) - np.cos(b)]
    print("\ndouble pendulum, 5 s: farthest node")
    for method, settings in METHODS.items():
        value = 1e-3 if settings.setting == "step" else 1e-12
        span = METHODS[method].integrator(equation, value).advance(x, np.zeros(0), 5.0, 1)
        print(f"  {method:16s} {np.abs(span.states[:4, -1] - tip).max():.1e} m")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print all tables."""
    given = options(__doc__, arguments, duration=20.0)
    orders()
    invariants(given.duration)
    pendulum()


if __name__ == "__main__":
    main()
