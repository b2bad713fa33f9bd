"""A linear controller with states of its own, such as one that python-control has designed."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.command import Command
from tenscontrol.control.controller import Controller
from tenscontrol.plant.input_bounds import input_bounds, largest_change
from tenscontrol.plant.linear_plant import LinearPlant, refuse_driven_bars
from tenscontrol.status import Status

_HOW = "control.sample_system(system, sample_time, 'tustin') makes a discrete one"


@final
class LinearController(Controller):
    """A discrete state-space system as a controller: ``u = u₀ + C x + D y``, ``x⁺ = A x + B y``.

    What it sees, y, are the states ``z = [q; q̇]`` of the plant or the node displacements δN, m.
    What it returns is the departure v of the inputs from the operating point, as of a plant in a
    loop with the sign of ``+``.

    Parameters
    ----------
    plant : LinearPlant
        Whose operating point the system is about.
    system : control.StateSpace or object with arrays A, B, C, D and a number dt
        Discrete, with its sample time ``dt``, s; or without states, a gain.
    sees : {"state", "nodes"}
        What its inputs are: those of ``plant.to_statespace(outputs=...)``.
    max_force_density : float or array_like, shape (α,), optional
        Largest force density γ commanded, N/m; only for a plant with γ as the input. The
        least is 0 always.
    max_change : float or array_like, shape (α,), optional
        Largest change of the command from sample to sample, N/m or m.
    winches : Winches, optional
        Speed and range that bound rest lengths.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or the system is continuous or has other signals.

    Examples
    --------
    >>> import control, tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> regulator = tc.LQR(plant, sample_time=0.01, max_force_density=50.0)
    >>> again = tc.control.LinearController(
    ...     plant, regulator.to_statespace(), sees="state", max_force_density=50.0)
    >>> again
    LinearController(0 states, 18 inputs, 9 outputs, every 0.01 s)
    """

    def __init__(
        self,
        plant: LinearPlant,
        system: Any,
        *,
        sees: str,
        max_force_density: object = None,
        max_change: object = None,
        winches: Winches | None = None,
    ) -> None:
        validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
        refuse_driven_bars(plant, "LinearController")
        self._system = _matrices(system)
        A, B, C, _ = self._system
        states, inputs = plant.B.shape
        validation.choice("sees", sees, ("state", "nodes"))
        seen = states if sees == "state" else len(plant.basis)
        if (B.shape[1], len(C)) != (seen, inputs):
            raise ValueError(
                f"system has {B.shape[1]} inputs and {len(C)} outputs, expected {seen} inputs, as "
                f"sees is {sees!r}, and {inputs} outputs"
            )
        sample_time = _sample_time(getattr(system, "dt", None), len(A))
        bounds = input_bounds(plant, max_force_density, winches)
        change = largest_change(plant.input, plant.actuation, max_change, winches, sample_time)
        super().__init__(plant, sample_time, *bounds, change)
        self._settings = dict(zip("ABCD", self._system, strict=True))
        self._sees_nodes = sees == "nodes"
        self._own_state = np.zeros(len(A))

    def reset(self) -> None:
        """See :meth:`BaseController.reset`; the states of the system are zero."""
        super().reset()
        self._own_state = np.zeros(len(self._system[0]))

    def reference_nodes(self, times: FloatArray) -> FloatArray:
        """See :meth:`Controller.reference_nodes`: the operating point."""
        return np.repeat(self.plant.nodes[:, :, None], len(times), axis=2)

    def _decide(self, time: float, state: FloatArray) -> Command:
        A, B, C, D = self._system
        seen = self.plant.basis @ state[: len(state) // 2] if self._sees_nodes else state
        desired = self.plant.equilibrium_input + C @ self._own_state + D @ seen
        self._own_state = A @ self._own_state + B @ seen
        reached = np.array_equal(self._within_bounds(desired), desired)
        return Command(desired, Status.OK if reached else Status.SATURATED)

    def __repr__(self) -> str:
        A, B, C, _ = self._system
        kind = "continuous" if self.sample_time is None else f"every {self.sample_time:g} s"
        return f"LinearController({len(A)} states, {B.shape[1]} inputs, {len(C)} outputs, {kind})"


def is_state_space(system: object) -> bool:
    """Return whether an object has the matrices of a state-space system."""
    return all(hasattr(system, name) for name in "ABCD") and not isinstance(system, LinearPlant)


def _matrices(system: Any) -> tuple[FloatArray, ...]:
    """Return A, B, C, D, checked."""
    if not is_state_space(system):
        raise validation.wrong_kind("system", system, "a control.StateSpace, with A, B, C and D")
    A, B, C, D = (
        validation.float_array(f"system.{name}", getattr(system, name)) for name in "ABCD"
    )
    if D.ndim != 2:
        raise ValueError(f"system.D has shape {D.shape}, expected (outputs, inputs)")
    count = len(A) if A.ndim else 0
    shapes = {"A": (count, count), "B": (count, D.shape[1]), "C": (len(D), count)}
    by_name = dict(zip("ABC", (A, B, C), strict=True))
    for name, shape in shapes.items():
        if by_name[name].size != np.prod(shape):
            raise ValueError(f"system.{name} has shape {by_name[name].shape}, expected {shape}")
    return (*(frozen(by_name[name].reshape(shape)) for name, shape in shapes.items()), frozen(D))


def _sample_time(dt: object, states: int) -> float | None:
    """Return the sample time of a system, s; None of a gain without one."""
    if dt is True:
        raise ValueError("system.dt is True, a sample time that is not known: give it in seconds")
    if dt is None or (isinstance(dt, int | float) and dt == 0):
        if states:
            raise ValueError(f"system is continuous and has {states} states: {_HOW}")
        return None
    return validation.positive_number("system.dt", dt, "s")
