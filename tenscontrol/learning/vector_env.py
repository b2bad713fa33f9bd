"""Many robots as one vectorized environment of gymnasium."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.winches import Winches
from tenscontrol.dynamics.model import Model
from tenscontrol.learning.tasks import Task
from tenscontrol.robustness.distributions import Distribution, draw_rows
from tenscontrol.simulation.stepper import Stepper

if TYPE_CHECKING:
    from gymnasium.vector import VectorEnv

_INSTALL = "environments are those of gymnasium: pip install 'tenscontrol[learning]'"


def vector_env(
    model: Model,
    task: Task,
    *,
    sample_time: float,
    step: float,
    method: str = "rk4_plain",
    winches: Winches,
    rest_length: Any,
    nodes: Any = None,
    actuated: object = None,
    count: int = 16,
    duration: float = 10.0,
    turned: bool = True,
    vary: Mapping[str, Distribution] | None = None,
    autoreset: str = "next_step",
    render_mode: str | None = None,
) -> VectorEnv:
    """Return many robots on one task as an environment of gymnasium.

    An action has one number per input, from −1 to 1: the rate at which its winch winds in (−) or
    lets out (+) over the sample, as part of its largest rate. An observation has the nodes relative
    to their centre, m, velocities, m/s, the values of the inputs, m, and what the task shows of its
    goal. An episode is terminated where the goal is reached or the motion has run away
    (``info["lost"]``), and truncated after ``duration``.

    Parameters
    ----------
    model : Model
        With a string law.
    task : Task
        :class:`Rolling`, :class:`Reach`, :class:`Track`, or one of your own.
    sample_time : float
        Time between actions, s.
    step : float
        Largest step of the integration, s; ``env.unwrapped.step_error()`` says what it errs.
    method : {"rk4_plain", "rk4"}
        As of :class:`tenscontrol.Stepper`.
    winches : Winches
        With a rate and a range.
    rest_length : float or array_like, shape (α,)
        At the start, m.
    nodes : array_like, shape (d, n), optional
        At the start, m.
    actuated : sequence of int or str, dict, array_like or Actuation, optional
        The strings that are driven, as in :func:`linearize`; all if not given.
    count : int
        Number of robots.
    duration : float
        Longest episode, s.
    turned : bool
        Whether an episode begins turned about the vertical by a random angle, of structures in
        space without supports.
    vary : dict, optional
        Distributions of parameters that a robot draws for each episode, by the names that
        :class:`tenscontrol.Stepper` has.
    autoreset : {"next_step", "same_step"}
        When a new episode begins: at the step after the last, or with it. In the second case the
        last observation is in ``info["final_obs"]``.
    render_mode : {"rgb_array"}, optional
        ``render()`` then returns a picture of each robot.

    Returns
    -------
    gymnasium.vector.VectorEnv

    Raises
    ------
    ImportError
        If gymnasium is not installed.
    TypeError, ValueError
        If an argument does not fit.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0, damping=1.0))
    >>> env = tc.vector_env(model, tc.learning.Reach(0, [0.5, 0.0, 0.9]), sample_time=0.05,
    ...                     step=1e-3, winches=tc.Winches(rate=0.2, shortest=0.3, longest=1.5),
    ...                     rest_length=0.95 * prism.string_length(), count=4)
    >>> seen, _ = env.reset(seed=0)
    >>> seen, reward, terminated, truncated, info = env.step(np.zeros((4, 9)))
    >>> seen.shape, reward.shape
    ((4, 48), (4,))
    """
    try:
        from gymnasium.vector import AutoresetMode

        from tenscontrol.learning.robots import Robots
    except ModuleNotFoundError as error:
        raise ImportError(_INSTALL) from error
    validation.instance("task", task, Task, "Rolling(...), Reach(...), Track(...)")
    validation.instance("winches", winches, Winches, "make them by Winches(rate=..., ...)")
    if winches.largest_rate is None or winches.shortest is None or winches.longest is None:
        raise ValueError(
            "winches have no rate or no range: give Winches(rate=..., shortest=..., longest=...), "
            "which actions are parts of"
        )
    count, drawn = validation.whole_number("count", count, 1), _checked(vary)
    stepper = Stepper(
        model, sample_time, step=step, method=method, rest_length=rest_length, nodes=nodes,
        winches=winches, actuated=actuated, count=count,
        parameters=draw_rows(drawn, np.random.default_rng(0), count),
    )  # fmt: skip
    task.check(model.structure)
    if render_mode is not None:
        validation.choice("render_mode", render_mode, ("rgb_array",))
    validation.truth("turned", turned, "whether episodes begin at random angles")
    duration = validation.positive_number("duration", duration, "s")
    validation.choice("autoreset", autoreset, ("next_step", "same_step"))
    mode = AutoresetMode[autoreset.upper()]
    return Robots(stepper, task, duration, turned, drawn, mode, render_mode)


def _checked(vary: Mapping[str, Distribution] | None) -> dict[str, Distribution]:
    """Return distributions by name; what has them is checked where parameters are drawn."""
    if vary is None:
        return {}
    validation.instance("vary", vary, Mapping, "a dict of distributions, by name")
    for name, kind in vary.items():
        validation.instance(f"vary[{name!r}]", kind, Distribution, "as Uniform(0.3, 0.9)")
    return dict(vary)
