"""Laws of the tension of a string."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Self, final

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.evaluator import Function, Prepared, SharedEvaluator
from tenscontrol.fields import Array, Field, converted
from tenscontrol.properties import cached_property
from tenscontrol.short_repr import short_repr

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# More would not fit in memory.
_MOST_STRINGS = 10_000_000


@dataclass(frozen=True, eq=False)
class StringLaw(ABC):
    """Base class of string laws: tension from length, rest length and rate.

    A string pulls or is slack; it never pushes. Parameters are one number for
    all strings or one per string. With damping c the tension while
    ``l > l0`` is ``T(l, l0) + c l̇``, never below zero.

    A law of your own is a frozen dataclass of its parameters, ``damping`` among them, with four
    formulas: :meth:`tension`, :meth:`taut_rest_length`, :meth:`stored_energy` and
    :attr:`largest_force_density`. In formulas lengths and parameters are CasADi expressions of one
    shape, or numbers: write them with operators and functions of CasADi. All parameters but the
    damping must be positive.
    """

    # Expressions in CasADi: the only statement of the law.

    __repr__ = short_repr

    @abstractmethod
    def tension(self, length: Any, rest_length: Any) -> Any:
        """Return the tension of a string longer than its rest length, N (negative below).

        Parameters
        ----------
        length, rest_length : casadi.SX or MX, shape (α, 1)
            l and l0, m.
        """

    @abstractmethod
    def taut_rest_length(self, length: Any, force_density: Any) -> Any:
        """Return the rest length at which a taut string has this force density, m.

        Parameters
        ----------
        length : casadi.SX or MX, shape (α, 1)
            l, m.
        force_density : casadi.SX or MX, shape (α, 1)
            γ, N/m.
        """

    @abstractmethod
    def stored_energy(self, length: Any, rest_length: Any) -> Any:
        """Return the elastic energy, J; 0 where the string is slack.

        Parameters
        ----------
        length, rest_length : casadi.SX or MX, shape (α, 1)
            l and l0, m.
        """

    @property
    @abstractmethod
    def largest_force_density(self) -> FloatArray:
        """Force densities that cannot be reached, N/m: γ must stay below. May be infinite."""

    @property
    @abstractmethod
    def damping(self) -> FloatArray:
        """Damping c, N s/m."""

    def __post_init__(self) -> None:
        given = {name: getattr(self, name) for name in self._names()}
        if given["damping"] is None:
            given["damping"] = 0.0
        parameters = {name: validation.vector(name, value) for name, value in given.items()}
        validation.member_parameters(parameters)
        for name, values in parameters.items():
            if name == "damping":
                validation.non_negative(name, np.atleast_1d(values), "damping takes energy out")
            else:
                validation.positive(name, np.atleast_1d(values), "number")
            object.__setattr__(self, name, frozen(values))

    @cached_property
    def is_damped(self) -> bool:
        """Whether any string has damping."""
        symbolic = isinstance(self.damping, ca.SX)
        return symbolic or bool(np.any(np.asarray(self.damping) > 0))

    def symbolic_force_density(self, length: Any, rest_length: Any, rate: Any = None) -> Any:
        """Return the expression of γ, N/m.

        Parameters
        ----------
        length, rest_length : casadi.SX or MX, shape (α, 1)
            l and l0, m.
        rate : casadi.SX or MX, shape (α, 1), optional
            l̇, m/s; needed only where the law is damped.
        """
        law = self.as_expressions()
        tension = law.tension(length, rest_length)
        if not self.is_damped:
            return ca.fmax(0, tension) / length
        pulling = ca.fmax(0, tension + law.damping * rate)
        return ca.if_else(length > rest_length, pulling, 0) / length

    def taut_force_density(self, length: Any, rest_length: Any, rate: Any = None) -> Any:
        """Return the expression of γ of a string that pulls, N/m: smooth, negative beyond.

        Arguments as :meth:`symbolic_force_density`.
        """
        law = self.as_expressions()
        tension = law.tension(length, rest_length)
        if self.is_damped:
            tension += law.damping * rate
        return tension / length

    def gap(self, length: Any, rest_length: Any, rate: Any = None) -> Any:
        """Return the expression of how far a string is from slack, m, positive where it pulls.

        A damped string stops pulling before it is as short as its rest length
        where it shortens fast; the tension that is left is measured in stretch.

        Arguments as :meth:`symbolic_force_density`.
        """
        stretch = length - rest_length
        if not self.is_damped:
            return stretch
        law = self.as_expressions()
        symbol = type(length).sym("at", length.shape)
        stiffness = ca.jtimes(law.tension(symbol, rest_length), symbol, ca.DM.ones(length.shape))
        stiffness = ca.substitute(stiffness, symbol, length)
        tension = law.tension(length, rest_length) + law.damping * rate
        return ca.fmin(stretch, tension / stiffness)

    def for_count(self, count: int) -> Self:
        """Return the same law with one parameter per string.

        Parameters
        ----------
        count : int
            Number α of strings.

        Raises
        ------
        ValueError
            If a parameter is given for another number of strings.
        """
        count = validation.whole_number("count", count, 0, _MOST_STRINGS)
        return type(self)(
            **{
                name: validation.per_member(name, getattr(self, name), count, "string")
                for name in self._names()
            }
        )

    def with_parameters(self, parameters: dict[str, Any]) -> Self:
        """Return the same law for expressions, with other parameters, unchecked.

        Parameters
        ----------
        parameters : dict of str to float, casadi.DM or casadi.SX
            A number, a column of them, or a symbol by name; others stay as they are.
            A symbol for the damping means that there is some.
        """
        law = object.__new__(type(self))
        for name in self._names():
            object.__setattr__(law, name, parameters.get(name, getattr(self, name)))
        return law

    def as_expressions(self) -> Self:
        """Return the same law with parameters as its formulas take them: symbols, or columns."""
        return self.with_parameters(
            {
                name: value if isinstance(value, ca.SX) else ca.DM(value)
                for name in self._names()
                for value in [getattr(self, name)]
            }
        )

    def _names(self) -> list[str]:
        names = [field.name for field in fields(self)]
        if "damping" not in names:
            raise TypeError(
                f"{type(self).__name__} has no parameter 'damping': make it a frozen dataclass "
                "with the field damping; 0.0 for none"
            )
        return names

    # The same law on NumPy arrays.

    def force_density(self, length: object, rest_length: object, rate: object = 0.0) -> FloatArray:
        """Return γ of strings of this length and rest length.

        Parameters
        ----------
        length, rest_length : float or array_like, shape (α,)
            Current length l and rest length l0, m, positive.
        rate : float or array_like, shape (α,)
            Rate l̇, m/s; matters only where there is damping.

        Returns
        -------
        ndarray, shape (α,)
            γ, N/m, at least 0; 0 while the string is slack.

        Raises
        ------
        TypeError, ValueError
            If an argument is not finite, not positive, or does not fit.
        """
        length, rest_length, rate = self._together(
            length=length, rest_length=rest_length, rate=rate
        )
        validation.positive("length", np.atleast_1d(length), "length in m")
        validation.positive("rest_length", np.atleast_1d(rest_length), "length in m")
        gamma = self._evaluated("force_density", length, rest_length, rate)
        return _representable("force density", gamma, bool(np.isfinite(gamma).all()))

    def rest_length(self, length: object, force_density: object) -> FloatArray:
        """Return the rest length at which strings of this length have this force density.

        A slack string has γ = 0 at every rest length from its length upwards.
        For γ = 0 the answer is the just taut one, l0 = l.

        Parameters
        ----------
        length : float or array_like, shape (α,)
            Current length l, m, positive.
        force_density : float or array_like, shape (α,)
            γ, N/m, at least 0.

        Returns
        -------
        ndarray, shape (α,)
            Rest length l0, m, at most ``length``.

        Raises
        ------
        TypeError, ValueError
            If an argument is not finite or does not fit, or if no rest length
            gives this γ: with constant stiffness k, γ must be below k.
        """
        length, gamma = self._together(length=length, force_density=force_density)
        validation.positive("length", np.atleast_1d(length), "length in m")
        validation.non_negative("force_density", np.atleast_1d(gamma), "a string can only pull")
        if (gamma >= self.largest_force_density).any():
            limit = np.broadcast_to(self.largest_force_density, np.shape(gamma))
            i = np.flatnonzero(np.atleast_1d(gamma >= limit))[0]
            raise ValueError(
                f"force_density[{i}] is {np.atleast_1d(gamma)[i]:g} N/m, expected less than the "
                f"stiffness {np.atleast_1d(limit)[i]:g} N/m: the rest length would not be "
                "positive. Use stiffer strings or a lower force density"
            )
        rest = self._evaluated("rest_length", length, gamma)
        return _representable("rest length", rest, bool((rest > 0).all()))

    def _together(self, **values: object) -> list[FloatArray]:
        """Check that arguments and parameters go together, and give them one shape."""
        arrays = {name: validation.vector(name, value) for name, value in values.items()}
        own = {name: np.asarray(getattr(self, name)) for name in self._names()}
        validation.member_parameters({**arrays, **own})
        shape = np.broadcast(*arrays.values(), *own.values()).shape
        return [a if a.shape == shape else np.broadcast_to(a, shape) for a in arrays.values()]

    def _evaluated(self, name: str, *arguments: FloatArray) -> FloatArray:
        count = arguments[0].size
        if count == 0:
            return np.zeros(arguments[0].shape)

        def build() -> SharedEvaluator:  # of one string, where all have the same parameters
            own = max(np.size(getattr(self, parameter)) for parameter in self._names())
            function = getattr(self, f"_{name}_function")(own)
            return SharedEvaluator(function if own == count else function.map(count))

        evaluated = self._evaluators.get((name, count), build)
        return evaluated(*arguments)[0].reshape(arguments[0].shape)

    @cached_property
    def _evaluators(self) -> Prepared:
        """Functions by what they return and the number of strings."""
        return Prepared()

    def _force_density_function(self, size: int) -> ca.Function:
        length, rest, rate = (ca.SX.sym(name, size) for name in ("length", "rest", "rate"))
        gamma = self.symbolic_force_density(length, rest, rate)
        return Function("force_density", [length, rest, rate], [ca.densify(ca.SX(gamma))])

    def _rest_length_function(self, size: int) -> ca.Function:
        length, gamma = ca.SX.sym("length", size), ca.SX.sym("gamma", size)
        rest = self.as_expressions().taut_rest_length(length, gamma)
        return Function("rest_length", [length, gamma], [ca.densify(ca.SX(rest))])


@final
@dataclass(frozen=True, eq=False)
class LinearStrings(StringLaw):
    """Strings of constant stiffness: ``T = k (l − l0) + c l̇`` while taut.

    Parameters
    ----------
    stiffness : float or array_like, shape (α,)
        Stiffness k of a string, N/m, positive: tension by stretch. It must be above the force
        density.
    damping : float or array_like, shape (α,)
        Damping c of a taut string, N s/m, at least 0; None for 0.

    Raises
    ------
    TypeError, ValueError
        If a parameter is not finite, the first is not positive, or a damping is negative.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> strings = tc.LinearStrings(stiffness=100.0)
    >>> rest_length = strings.rest_length(length=1.0, force_density=20.0)
    >>> rest_length, strings.force_density(1.0, rest_length)
    (array(0.8), array(20.))
    """

    stiffness: Array = converted()
    damping: Field[ArrayLike | None, FloatArray] = converted(0.0)

    __repr__ = short_repr

    def tension(self, length: Any, rest_length: Any) -> Any:
        """Return k (l − l0), N; see :meth:`StringLaw.tension`."""
        return self.stiffness * (length - rest_length)

    def taut_rest_length(self, length: Any, force_density: Any) -> Any:
        """Return l (1 − γ/k), m; see :meth:`StringLaw.taut_rest_length`."""
        return length * (1 - force_density / self.stiffness)

    def stored_energy(self, length: Any, rest_length: Any) -> Any:
        """Return ½ k max(0, l − l0)², J; see :meth:`StringLaw.stored_energy`."""
        return 0.5 * self.stiffness * ca.fmax(0, length - rest_length) ** 2

    @property
    def largest_force_density(self) -> FloatArray:
        """The stiffness k: γ = k would need a rest length of zero."""
        return self.stiffness


@final
@dataclass(frozen=True, eq=False)
class ElasticStrings(StringLaw):
    """Strings of constant axial rigidity: ``T = EA (l − l0)/l0 + c l̇`` while taut.

    A string becomes stiffer when its rest length is reduced.

    Parameters
    ----------
    axial_rigidity : float or array_like, shape (α,)
        Axial rigidity EA, N, positive: Young's modulus times cross-section.
    damping : float or array_like, shape (α,)
        Damping c of a taut string, N s/m, at least 0; None for 0.

    Raises
    ------
    TypeError, ValueError
        If a parameter is not finite, the first is not positive, or a damping is negative.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> strings = tc.ElasticStrings(axial_rigidity=100.0)
    >>> rest_length = strings.rest_length(length=1.0, force_density=25.0)
    >>> rest_length, strings.force_density(1.0, rest_length)
    (array(0.8), array(25.))
    """

    axial_rigidity: Array = converted()
    damping: Field[ArrayLike | None, FloatArray] = converted(0.0)

    __repr__ = short_repr

    def tension(self, length: Any, rest_length: Any) -> Any:
        """Return EA (l/l0 − 1), N; see :meth:`StringLaw.tension`."""
        return self.axial_rigidity * (length / rest_length - 1)

    def taut_rest_length(self, length: Any, force_density: Any) -> Any:
        """Return EA l/(EA + γ l), m; see :meth:`StringLaw.taut_rest_length`."""
        # Written so that γ = 0 gives l exactly.
        return length / (1 + force_density * length / self.axial_rigidity)

    def stored_energy(self, length: Any, rest_length: Any) -> Any:
        """Return ½ EA/l0 max(0, l − l0)², J; see :meth:`StringLaw.stored_energy`."""
        return 0.5 * self.axial_rigidity * ca.fmax(0, length - rest_length) ** 2 / rest_length

    @property
    def largest_force_density(self) -> FloatArray:
        """Infinite: every γ has a positive rest length."""
        return np.full(np.shape(self.axial_rigidity), np.inf)


def _representable(quantity: str, values: FloatArray, fine: bool) -> FloatArray:
    """Refuse a result that left the range of double precision."""
    if not fine:
        raise ValueError(
            f"the {quantity} {values} is out of the range of double precision: "
            "lengths, force densities and stiffness differ by too many powers of ten"
        )
    return values
