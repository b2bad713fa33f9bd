"""Largest stable step of a method, over stiffness and mass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from tenscontrol import validation
from tenscontrol.accuracy.measured_run import checked_settings, method_named
from tenscontrol.accuracy.open_loop import fastest_rate
from tenscontrol.actuation.rest_lengths import to_rest_length
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.string_laws import LinearStrings
from tenscontrol.integrate.integrator import IntegrationError
from tenscontrol.integrate.methods import Method
from tenscontrol.interrupt import keeping
from tenscontrol.progress import progress_bar
from tenscontrol.simulation.scene import Scene
from tenscontrol.statics.prestress import prestress
from tenscontrol.structure.bar_geometry import restore_bar_lengths
from tenscontrol.structure.prism import prism
from tenscontrol.structure.segments import spread_force_density, subdivide
from tenscontrol.tables import aligned

# A motion with more than so many times its kinetic energy is not stable.
_GROWN = 100.0

# Tried as h ω: first, then upward, or downward; and near the limit of theory, by it. The border
# is then bisected to this ratio.
_FIRST, _CLOSE = 0.9, 1.01
_UPWARD = tuple(_FIRST * 1.25**k for k in range(1, 20))
_DOWNWARD = tuple(_FIRST * 0.5**k for k in range(1, 7))
_NEAR = (0.97, 1.03)

# Step of the run that tells how large the kinetic energy truly is, as h ω.
_FINE = 0.2

# Steps that are taken at once.
_PART = 32

# s: no step is longer.
_LONGEST = 1e9


@dataclass(frozen=True, eq=False)
class StabilityMap:
    """Largest stable steps. Made by :func:`stability_map`.

    Attributes
    ----------
    method : str
    stiffness : ndarray, shape (S,)
        N/m.
    mass_ratio : ndarray, shape (M,)
        Mass of a string node over that of a bar.
    step : ndarray, shape (S, M)
        Largest stable step, s; infinite where every step tried was stable, zero where none.
        NaN, with the rate, for cases left out as the user interrupted.
    rate : ndarray, shape (S, M)
        Fastest rate of the linearized motion ω, 1/s.
    limit : float
        Largest stable ``h ω`` by theory; NaN where none is known.
    """

    method: str
    stiffness: FloatArray
    mass_ratio: FloatArray
    step: FloatArray
    rate: FloatArray
    limit: float

    @property
    def bound(self) -> FloatArray:
        """Largest stable step by theory, s, shape (S, M)."""
        return np.asarray(self.limit / self.rate)

    def table(self) -> str:
        """Return steps, rates and their product, which theory bounds, as text."""
        theory = f"theory {self.limit:.3f}" if np.isfinite(self.limit) else "no bound is known"
        rows = []
        for i, j in np.ndindex(self.step.shape):
            step, rate = self.step[i, j], self.rate[i, j]
            case = [f"{self.stiffness[i]:.3g}", f"{self.mass_ratio[j]:.3g}", f"{rate:.4g}"]
            rows.append([*case, f"{step:.3g}", f"{step * rate:.3f}"])
        head = ["stiffness N/m", "mass ratio", "rate 1/s", "largest stable h s", "h times rate"]
        return f"{self.method}: h times rate by {theory}\n\n" + aligned(head, rows, left=0)

    def __repr__(self) -> str:
        return f"StabilityMap({self.method}, {len(self.stiffness)} x {len(self.mass_ratio)})"


def stability_map(
    method: str,
    stiffness: Sequence[float] = (1e2, 1e3, 1e4, 1e5),
    mass_ratio: Sequence[float] = (1e-1, 1e-2, 1e-3),
    case: Callable[[float, float], Scene] | None = None,
    steps: int = 1000,
    progress: bool = False,
) -> StabilityMap:
    """Return the largest stable step of a method over stiffness and mass.

    A step is stable if the kinetic energy of a run with it never exceeds a hundred times that of a
    run with a fine step. Steps are tried from small to large, in ratios of 1.25 and finer near the
    theoretical limit. The limit is then found by bisection to 1 %.

    Parameters
    ----------
    method : str
        One that takes a step.
    stiffness : sequence of float
        Of a whole string, N/m.
    mass_ratio : sequence of float
        Mass of a string node over that of a bar.
    case : callable, optional
        ``(stiffness, mass_ratio) -> Scene``, near rest; its duration does not
        count. If not given: a prism with bars of 1 kg under γ_t = 17.3205 N/m,
        each string cut in two, its nodes 1e-5 m off rest.
    steps : int
        Steps of each run. The more, the slower a growth is seen.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    StabilityMap
        Of the cases done by then, if Ctrl-C or SIGTERM ends it; a warning says so.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, with its name; if
        the method chooses its own steps.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> found = tc.stability_map("rk4", [1e3], [0.1])
    >>> bool(abs(found.step[0, 0] / found.bound[0, 0] - 1) < 0.03)
    True
    """
    chosen = method_named(method)
    if chosen.setting != "step":
        raise ValueError(f"method is {method!r}, which chooses its steps; expected one with a step")
    stiff = checked_settings("stiffness", stiffness, "N/m")[::-1]
    ratios = checked_settings("mass_ratio", mass_ratio, "1")[::-1]
    count = validation.whole_number("steps", steps, 20, validation.MOST_RUNS)
    make = prism_near_rest if case is None else case
    validation.function("case", make, "(stiffness, mass_ratio) -> Scene")
    limit = theoretical_limit(method)
    shape = (len(stiff), len(ratios))
    step, rate = np.full((2, *shape), np.nan)
    interruptible = keeping("cases are done, the others NaN", lambda: int(np.isfinite(rate).sum()))
    with (
        interruptible,
        progress_bar(step.size, progress, f"stability of {method}", "cases") as report,
    ):
        for i, j in np.ndindex(shape):
            scene = make(stiff[i], ratios[j])
            validation.instance(
                "what case(stiffness, mass_ratio) returns", scene, Scene, "make one by Scene()"
            )
            fastest = fastest_rate(scene)
            step[i, j] = _Probe(scene, chosen, fastest, count).largest_step(limit)
            rate[i, j] = fastest
            report(i * shape[1] + j + 1)
    return StabilityMap(
        method=method,
        stiffness=frozen(np.array(stiff)),
        mass_ratio=frozen(np.array(ratios)),
        step=frozen(step),
        rate=frozen(rate),
        limit=limit,
    )


class _Probe:
    """Tries steps on one case."""

    def __init__(self, case: Scene, method: Method, rate: float, count: int) -> None:
        self._case, self._rate, self._count = case, rate, count
        # Steps are shortened to fit between outputs: with an output a step, one integrator,
        # which is costly to build, takes steps of any length.
        self._integrator = method.integrator(case.equation(method.differentiates), _LONGEST)
        self._allowed = np.inf
        self._allowed = _GROWN * self._energy(_FINE)

    def largest_step(self, limit: float) -> float:
        """Return the largest step, s, up to which all that are tried are stable."""
        low, high = 0.0, _FIRST
        if self._is_stable(_FIRST):
            low = _FIRST
            # Beyond its limit a method may be stable again: just above it is looked at too.
            near = [share * limit for share in _NEAR if limit > _FIRST]
            for product in sorted([*_UPWARD, *near]):
                if not self._is_stable(product):
                    high = product
                    break
                low = product
            else:
                return float("inf")
        else:
            for product in _DOWNWARD:
                if self._is_stable(product):
                    low = product
                    break
                high = product
            else:
                return 0.0
        while high / low > _CLOSE:
            middle = float(np.sqrt(low * high))
            low, high = (middle, high) if self._is_stable(middle) else (low, middle)
        return low / self._rate

    def _is_stable(self, product: float) -> bool:
        return isfinite(self._energy(product))

    def _energy(self, product: float) -> float:
        """Return the largest kinetic energy of a run with this h ω, J; infinite if not allowed."""
        state, step, largest = self._case.state, product / self._rate, 0.0
        for first in range(0, self._count, _PART):
            count = min(_PART, self._count - first)
            try:
                span = self._integrator.advance(state, self._case.input_value, step * count, count)
            except IntegrationError:
                return float("inf")
            with np.errstate(over="ignore", invalid="ignore"):
                (kinetic,) = evaluate_columns(self._case.model.kinetic_energy, span.states)
                largest = max(largest, float(kinetic.max()))
            if not largest <= self._allowed:
                return float("inf")
            state = span.states[:, -1]
        return largest


def prism_near_rest(stiffness: float, mass_ratio: float) -> Scene:
    """Return a prism near rest with a point mass amid each string, of this stiffness, N/m."""
    segments, disturbance = 2, 1e-5
    bare = prism()
    rest = prestress(bare, force_density=17.3205)
    structure = subdivide(bare, segments=segments, node_mass=mass_ratio)
    model = Model(structure, strings=LinearStrings(segments * stiffness))
    gamma = spread_force_density(structure, rest.force_density)
    start = to_rest_length(model, structure.nodes, gamma).rest_length
    moves = np.random.default_rng(0).normal(size=structure.nodes.shape)
    nodes = restore_bar_lengths(structure, structure.nodes + disturbance * moves)
    case = Scene(model, 1.0, rest_length=start, name=f"k = {stiffness:g} N/m")
    return replace(case, nodes=nodes)


def theoretical_limit(method: str) -> float:
    """Return the largest ``h ω`` at which an undamped oscillation stays bounded; NaN if not known.

    2√2 for the classical Runge-Kutta method, by its region of stability on the imaginary axis
    (Hairer & Wanner, *Solving Ordinary Differential Equations II*, IV.2).
    """
    return float(np.sqrt(8)) if method in ("rk4", "rk4_plain") else float("nan")
