"""Inputs that tell most of unknown parameters, within the limits of winches."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.profile import Profile
from tenscontrol.integrate.integrator import IntegrationError
from tenscontrol.optimize.fit import Identifiability, identifiability_of
from tenscontrol.optimize.rollouts import Rollouts
from tenscontrol.progress import progress_bar
from tenscontrol.simulation.plant_run import StoppedError
from tenscontrol.tables import aligned

# Part of the rollouts that random inputs get; the best of them is improved.
_RANDOM = 0.2

# Part of a rest length down to which winches wind it where they have no shortest.
_SHORTEST = 0.1

# What a winch can do in a part of the time: wind in, stay, or pay out.
_MOVES = np.array([-1.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False, repr=False)
class ExcitingInput:
    """An input that tells much of unknown parameters. Made by :func:`exciting_input`.

    Attributes
    ----------
    profile : Profile
        Rest lengths, m, in straight lines from time to time.
    before, after : Identifiability
        What readings tell with the input of the log, and with this one.
    log_determinant : ndarray, shape (rollouts,)
        Of the information that was best after each rollout, natural, of the matrix in the units of
        the unknowns.
    """

    profile: Profile
    before: Identifiability
    after: Identifiability
    log_determinant: FloatArray

    def table(self) -> str:
        """Return as text what is left of the prior deviation of each unknown, before and after."""
        rows = [
            [label, f"{before:.2g}", f"{after:.2g}"]
            for label, before, after in zip(
                self.after.labels, self.before.deviation, self.after.deviation, strict=True
            )
        ]
        return aligned(["deviation left of", "before", "after"], rows)

    def __repr__(self) -> str:
        ratio = float(np.exp(np.log(self.before.deviation / self.after.deviation).mean()))
        return (
            f"ExcitingInput({len(self.profile.time)} times, deviations {ratio:.3g} times smaller, "
            f"{len(self.log_determinant)} rollouts)"
        )


def exciting_input(
    told: Identifiability, winches: Winches, *, parts: int = 6, most_rollouts: int = 200,
    seed: int = 0, progress: bool = False,
) -> ExcitingInput:  # fmt: skip
    """Return rest lengths in time from whose readings a fit tells most.

    They maximize log det(1 + Sᵀ S), with S the slope of the readings, in deviations of their noise,
    by the unknowns, in deviations of their priors (D-optimality). In each part of the time each
    winch winds in, stays or pays out at its largest rate; the best of some random inputs is
    improved string by string and part by part, as long as that helps.

    Parameters
    ----------
    told : Identifiability
        Made by :func:`identifiable` of a model, unknowns and one log of an experiment, as it was
        done or is planned. Its readings are not used, but which of them were lost. The input begins
        at the rest lengths of the log.
    winches : Winches
        Whose rates, m/s, and range the rest lengths keep to.
    parts : int
        Of the time.
    most_rollouts : int
        Simulations with derivatives at most.
    seed : int
        Of the random inputs.
    progress : bool
        Whether to show a progress bar; never shown away from a terminal.

    Returns
    -------
    ExcitingInput

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind, winches have no rate or do not fit, or there are
        several logs, or one that holds force densities.

    Notes
    -----
    V. V. Fedorov, *Theory of Optimal Experiments*, 1972; the search is the coordinate exchange of
    R. K. Meyer & C. J. Nachtsheim, Technometrics 37 (1995), 60-69, doi:10.2307/1269153. It finds a
    good input, not the best of all. The motion is that of the model: where parameters are far off,
    fit a first log, and plan the next by what was found.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.5))
    >>> sensors = tc.Sensors(structure=prism, node_position=0.001)
    >>> held = 0.95 * prism.string_length()
    >>> run = tc.simulate(model, 0.4, rest_length=held, output_step=0.02)
    >>> log = tc.Log.of_run(run, sensors, np.linspace(0.02, 0.4, 20))
    >>> winches = tc.Winches(rate=0.3)
    >>> told = tc.identifiable(model, log, ["stiffness"])
    >>> plan = tc.exciting_input(told, winches, parts=2, most_rollouts=20)
    >>> bool(plan.log_determinant[-1] > plan.log_determinant[0])
    True
    """
    validation.instance("told", told, Identifiability, "ask identifiable(model, log, parameters)")
    validation.instance("winches", winches, Winches, "make them by Winches(rate=...)")
    rollouts = told.rollouts
    if len(rollouts.logs) > 1:
        raise ValueError(f"told is of {len(rollouts.logs)} logs, expected that of one")
    if rollouts.logs[0].input != "rest_length":
        raise ValueError("the log holds force_density, expected rest lengths, which winches wind")
    if winches.largest_rate is None or not np.isfinite(winches.largest_rate).all():
        raise ValueError("winches have no rate: give Winches(rate=...), in m/s")
    parts = validation.whole_number("parts", parts, 1, len(rollouts.logs[0].time))
    most = validation.whole_number("most_rollouts", most_rollouts, 2)
    seed = validation.whole_number("seed", seed, 0, validation.LARGEST_SEED)
    search = _Search(rollouts, winches, parts)
    with progress_bar(float(most), progress, "planning", "rollouts") as report:
        best = search.run(most, np.random.default_rng(seed), report)
    after = identifiability_of(search.rollouts_with(best.moves), best.slope)
    return ExcitingInput(
        search.profile(best.moves), told, after, frozen(np.maximum.accumulate(search.values))
    )


class _Input(NamedTuple):
    moves: FloatArray  # of winches, (strings, parts), each -1, 0 or 1
    value: float
    slope: FloatArray | None


class _Search:
    """Coordinate exchange of the moves of winches."""

    def __init__(self, rollouts: Rollouts, winches: Winches, parts: int) -> None:
        self._rollouts, self._log, self._winches = rollouts, rollouts.logs[0], winches
        held = self._log.rest_length
        begin = held.at(0.0) if isinstance(held, Profile) else held
        strings = len(rollouts.model.structure.strings)
        self._begin = np.broadcast_to(np.asarray(begin, dtype=float).ravel(), (strings,))
        self._shape = strings, parts
        rollouts.model_for(np.zeros(rollouts.size))  # which all copies keep
        self.values: list[float] = []

    def profile(self, moves: FloatArray) -> Profile:
        """Return the rest lengths that winches reach by moves."""
        times = np.linspace(0.0, float(self._log.time[-1]), self._shape[1] + 1)
        lengths = [np.array(self._begin)]
        for move in moves.T:
            moved = lengths[-1] + move * np.asarray(self._winches.largest_rate) * times[1]
            wanted = np.maximum(moved, _SHORTEST * self._begin)
            lengths.append(self._winches.move(lengths[-1], wanted, float(times[1])).rest_length)
        return Profile(times, np.stack(lengths, axis=1))

    def rollouts_with(self, moves: FloatArray) -> Rollouts:
        """Return the rollouts with moves in place of the input of the log."""
        other = copy(self._rollouts)
        other.logs = (replace(self._log, rest_length=self.profile(moves)),)
        return other

    def run(
        self, most: int, random: np.random.Generator, report: Callable[[float], None]
    ) -> _Input:
        """Return the best input after so many rollouts at most."""
        best = self._tried(np.zeros(self._shape))
        for _ in range(int(_RANDOM * most)):
            best = self._better(best, random.choice(_MOVES[[0, 2]], self._shape))
            report(len(self.values))
        while len(self.values) < most:
            before = best
            for entry in random.permutation(best.moves.size):
                string, piece = np.unravel_index(entry, self._shape)
                for move in _MOVES[best.moves[string, piece] != _MOVES]:
                    if len(self.values) >= most:
                        return best
                    moves = best.moves.copy()
                    moves[string, piece] = move
                    best = self._better(best, moves)
                    report(len(self.values))
            if best is before:
                break
        return best

    def _better(self, best: _Input, moves: FloatArray) -> _Input:
        return max(best, self._tried(moves), key=attrgetter("value"))

    def _tried(self, moves: FloatArray) -> _Input:
        """Return an input with log det of the information; -inf where the motion runs away."""
        rollouts = self.rollouts_with(moves)
        try:
            slope = rollouts.readings(np.zeros(rollouts.size), 1.0, slopes=True).slope
        except (IntegrationError, StoppedError):
            slope = None
        value = -np.inf
        if slope is not None and np.isfinite(slope).all():
            scaled = slope * rollouts.deviations
            value = float(np.linalg.slogdet(np.eye(rollouts.size) + scaled.T @ scaled)[1])
        self.values.append(value)
        return _Input(moves, value, slope)
