"""Settings of an integration: method, step or tolerance, states kept, limits on the result."""

from __future__ import annotations

from dataclasses import dataclass, field

from tenscontrol import validation
from tenscontrol.fields import check_fields, checked, optional
from tenscontrol.integrate.methods import METHODS, Method, method_of
from tenscontrol.simulation.health import HealthLimits

# Where none is given.
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Integration:
    """How a motion is integrated, which states are kept, and how it is judged.

    Parameters
    ----------
    method : str or Method
        ``"auto"``, one of :data:`METHODS`, or a :class:`Method` of your own; see :func:`simulate`.
    tolerance : float
        Error allowed a step of a method that chooses its own steps, as part of
        the size of the structure and of its characteristic speed. It does not go with ``step``.
    step : float, optional
        Step of a method with a fixed step, s.
    output_step : float, optional
        Largest time between states kept, s; see :func:`simulate`.
    project : bool, optional
        Whether to make the bar lengths exact after each step; see :func:`simulate`.
    error : {"estimate", "none"}
        Whether to estimate the error of the motion, by a second run at another resolution.
    limits : HealthLimits
        Limits on the figures in ``run.health``.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, with its name.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> scene = tc.Scene(
    ...     tc.Model(tc.prism()), 0.1, force_density=10.0, integration=tc.Integration(step=1e-3))
    >>> scene.simulate()
    Trajectory(0.1 s, 101 states, rk4)
    """

    method: str | Method = "auto"
    tolerance: float = field(
        default=_TOLERANCE, metadata=checked(validation.positive_number, "of size and speed")
    )
    step: float | None = field(default=None, metadata=optional(validation.positive_number, "s"))
    output_step: float | None = field(
        default=None, metadata=optional(validation.positive_number, "s")
    )
    project: bool | None = field(
        default=None,
        metadata=optional(validation.truth, "whether to make bar lengths exact after each step"),
    )
    error: str = field(
        default="estimate", metadata=checked(validation.choice, ("estimate", "none"))
    )
    limits: HealthLimits = field(
        default_factory=HealthLimits,
        metadata=checked(
            validation.instance, HealthLimits, "make them by HealthLimits(bar_length_error=...)"
        ),
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.step is not None and self.tolerance != _TOLERANCE:
            raise ValueError(
                f"step is {self.step:g} s and tolerance is {self.tolerance:g}, expected one of "
                "them: steps of a fixed size have no tolerance. Leave step out for a method that "
                "chooses its own, or tolerance"
            )
        method = method_of(self.method)
        if method is None:
            return
        if "tolerance" not in method.settings and self.step is None:
            raise ValueError(f"method {method.name!r} needs a step, s; for example step=1e-3")
        if "step" not in method.settings and self.step is not None:
            fixed = [name for name, known in METHODS.items() if "step" in known.settings]
            raise ValueError(
                f"step goes with the methods {fixed}; {method.name!r} chooses its own steps by "
                "tolerance"
            )

    @property
    def chosen(self) -> Method | None:
        """The method asked for; None where it is left to the simulation."""
        return method_of(self.method)
