"""A function, or an object with a method ``command``, as a controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from typing import Any, final

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    Actuation,
    actuation_of,
    bounds_of_inputs,
    inputs_of,
)
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.control.command import Command
from tenscontrol.control.controller import BaseController
from tenscontrol.control.linear_controller import is_state_space
from tenscontrol.dynamics.model import Model
from tenscontrol.plant.input_bounds import largest_change, rest_length_bounds
from tenscontrol.plant.linear_plant import INPUTS
from tenscontrol.status import Status
from tenscontrol.structure.segments import whole_strings
from tenscontrol.structure.structure import Structure

_UNITS = {"force_density": "γ, N/m", "rest_length": "rest length, m"}

_EXPECTED = (
    "a controller such as LQR(...) or MPC(...), a function (time, nodes, velocities) -> command, "
    "or an object with a method command(time, nodes, velocities)"
)


@final
class FunctionController(BaseController):
    """Your own function or object as a controller, with bounds and a fallback.

    ``simulate(model, duration, controller=function)`` makes one from the function. Make it
    yourself to set bounds, to command γ where the actuators hold rest lengths or the other way
    round, or to measure and command the segments of subdivided strings.

    The function is called once a sample as ``function(time, nodes, velocities)``: s; m and m/s,
    shape (d, n) each. It returns an array_like of shape (α,): one γ, N/m, or rest length, m, per
    string of the structure, or per input if ``actuated`` is given. It may also return a
    :class:`Command` of these values, with a status. In place of a function, an object may have

    - ``command(time, nodes, velocities)``, which is called in this way;
    - ``input``, ``sample_time`` and ``actuated``, used where they are not given here;
    - ``reset()``, called at the start of each run;
    - ``begin(model, nodes)``, called then with the model of the run and its nodes at the start;
    - ``applied(value)``, called after each command with the input that the actuators reached,
      shape (α,), and before the first with the rest lengths at the start, if they are known.

    A command beyond the bounds is set to the nearest one within, with the status
    ``"saturated"``. The function is not called with a measurement that the structure cannot have,
    and a command that is not finite is not applied. The previous input is held in both cases, or
    ``equilibrium_input`` if γ is the input and it is given. ``status_count``, ``fallback_count``
    and the record of the run count these cases.

    Parameters
    ----------
    structure : Structure
        Whose nodes it is given and whose strings it commands: that of the model, or its parent if
        strings are subdivided.
    function : callable, or object with a method ``command``
    input : {"force_density", "rest_length"}, optional
        What it commands; that of the object if not given.
    sample_time : float, optional
        Time between two commands, s; that of the object if not given, and of the simulation if it
        has none.
    low : float or array_like, shape (α,), optional
        Least command, N/m or m; γ of 0, or a hundredth of the string's length in the shape of the
        structure, if not given.
    high : float or array_like, shape (α,), optional
        Largest command, N/m or m; none if not given.
    max_change : float or array_like, shape (α,), optional
        Largest change of the command from sample to sample, N/m or m.
    equilibrium_input : float or array_like, shape (α,), optional
        What is commanded without a decision at the first sample; γ at any sample; N/m or m.
    actuated : sequence of int or str, dict, array_like or Actuation, optional
        The strings that are driven, as in :func:`linearize`: the function then returns one value an
        input, and :meth:`applied` tells as many. Passive strings keep their rest lengths of the
        start of a run, or γ of ``equilibrium_input``.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit. By :meth:`command`: if what the function returns does not; what
        the function raises goes through.

    Notes
    -----
    For sweeps it must be possible to pickle the function: define it, or its class, at the top of
    a module. A lambda and a function within a function cannot be pickled.

    Examples
    --------
    Strings wound in as fast as they grow, as dampers would pull:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> rest = tc.prestress(prism, force_density=10.0)
    >>> start = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    >>> def damper(time, nodes, velocities):
    ...     strings, rates = prism.string_vectors(nodes), prism.string_vectors(velocities)
    ...     return start - 0.05 * (strings * rates).sum(axis=0) / prism.string_length(nodes)
    >>> own = tc.FunctionController(prism, damper, input="rest_length", max_change=0.01,
    ...                             sample_time=0.02)
    >>> run = tc.simulate(model, 0.1, controller=own, rest_length=start, step=1e-3)
    >>> run.control.controller, run.control.status_count == {"ok": 5}
    ("FunctionController(damper, input 'rest_length', every 0.02 s)", True)
    """

    def __init__(
        self,
        structure: Structure,
        function: Any,
        *,
        input: str | None = None,
        sample_time: float | None = None,
        low: object = None,
        high: object = None,
        max_change: object = None,
        equilibrium_input: object = None,
        actuated: object = None,
    ) -> None:
        validation.instance("structure", structure, Structure, "for example model.structure")
        self._function = _called("function", function)
        self._given = function
        self._settings = {"function": function}
        if input is None:
            input = _own("input", function)
            if input is None:
                raise ValueError(
                    "input is not given, and function has none: give what it commands by "
                    "input='rest_length' or input='force_density'"
                )
        if sample_time is None:
            sample_time = _own("sample_time", function)
        if actuated is None:
            actuated = _own("actuated", function)
        by_length = validation.choice("input", input, INPUTS) == "rest_length"
        count = len(structure.strings)
        if low is None:
            low = rest_length_bounds(structure.string_length())[0] if by_length else 0.0
        low = validation.per_member("low", low, count, "string")
        if by_length:
            validation.positive("low", low, "rest length in m")
        else:
            validation.non_negative("low", low, "a string can only pull")
        high = validation.limit_per_member("high", high, count, "string")
        usual = structure.string_length()
        if equilibrium_input is not None:
            usual = validation.per_member("equilibrium_input", equilibrium_input, count, "string")
        elif actuated is not None and not by_length:
            raise ValueError(
                "actuated leaves strings passive, whose γ is not known: give equilibrium_input, γ "
                "of all strings, N/m"
            )
        self._of_strings = actuation_of(structure, actuated, usual)
        low, high = bounds_of_inputs(self._of_strings, low, high)
        change = largest_change(input, self._of_strings, max_change, None, sample_time)
        if equilibrium_input is not None:
            equilibrium_input = frozen(inputs_of(self._of_strings, usual))
        super().__init__(
            structure, input, sample_time, low, high, change,
            equilibrium_input=equilibrium_input,
        )  # fmt: skip
        self._what = f"the command of {self.label}"

    def _driven(self) -> Actuation:
        return self._of_strings

    @property
    def label(self) -> str:
        """Name of the function, or of the class of the object."""
        named = self._given if self._function is self._given else type(self._given)
        name = getattr(named, "__qualname__", type(named).__qualname__)
        return str(name.rpartition("<locals>.")[2])

    def reset(self) -> None:
        """Forget the previous input and the counts; an object's own ``reset`` is called."""
        super().reset()
        self._tell("reset")

    def begin(self, model: Model, nodes: FloatArray) -> None:
        """Reset, and tell an object with ``begin`` of the run."""
        super().begin(model, nodes)
        self._tell("begin", model, nodes)

    def applied(self, value: object) -> None:
        """Set the previous input, and tell an object with ``applied``."""
        super().applied(value)
        self._tell("applied", self._previous_input)

    def _tell(self, method: str, *arguments: object) -> None:
        own = _own(method, self._given)
        if own is not None:
            own(*arguments)

    def _decide(self, time: float, state: FloatArray) -> Command:
        nodes, velocities = state
        given = self._function(time, nodes, velocities)
        command = given if isinstance(given, Command) else Command(given)
        validation.instance(
            f"status of {self._what}", command.status, Status, "for example Status.OK"
        )
        meaning = f"one {_UNITS[self.input]}, per string or input"
        value = validation.measured(self._what, command.value, self._low.shape, meaning)
        command = replace(command, value=value)
        if command.status is Status.OK and not np.array_equal(self._within_bounds(value), value):
            return replace(command, status=Status.SATURATED)
        return command

    def __repr__(self) -> str:
        when = "" if self.sample_time is None else f", every {self.sample_time:g} s"
        return f"FunctionController({self.label}, input {self.input!r}{when})"


def as_controller(
    controller: object,
    structure: Structure,
    held: str,
    sample_time: object = None,
    **settings: Any,
) -> BaseController:
    """Return a controller as it is, or a function as one on a structure with whole strings.

    It commands what is ``held``, unless it says otherwise, and so for the sample time. Settings
    are those of :class:`FunctionController`.
    """
    if isinstance(controller, BaseController):
        return controller
    if is_state_space(controller):
        raise TypeError(
            f"controller is a {type(controller).__name__}, which does not say about which shape "
            "and input it acts: give control.LinearController(plant, system, "
            "sees=...)"
        )
    _called("controller", controller)
    own = {
        "input": _own("input", controller) or held,
        "sample_time": _own("sample_time", controller) or sample_time,
    }
    return FunctionController(whole_strings(structure), controller, **own | settings)


def _own(name: str, given: object) -> Any:
    """Return what an object with a method ``command`` says of itself; None of a function."""
    return getattr(given, name, None) if callable(getattr(given, "command", None)) else None


def _refuse_other_arguments(name: str, called: Callable[..., Any]) -> None:
    """Refuse a function that cannot be called with a time, nodes and velocities."""
    try:
        taken = signature(called)
    except ValueError:  # of some functions in C nobody knows
        return
    try:
        taken.bind(0.0, None, None)
    except TypeError as error:
        raise TypeError(
            f"{name} has the arguments {taken}, expected (time, nodes, velocities): {error}"
        ) from None


def _called(name: str, given: object) -> Callable[..., Any]:
    """Return what is called at each sample: the method ``command``, or the function itself."""
    if isinstance(given, type):
        raise TypeError(
            f"{name} is the class {given.__name__}, expected an object of it: make one by "
            f"{given.__name__}(...)"
        )
    called: Any = _own("command", given) or given
    if not callable(called):
        raise validation.wrong_kind(name, given, _EXPECTED)
    _refuse_other_arguments(name, called)
    return called  # type: ignore[no-any-return]
