"""The result of a simulation."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.core.records import Conservation
from tenscontrol.dynamics.contact_laws import ContactLaw
from tenscontrol.dynamics.evaluator import Function, evaluate_columns
from tenscontrol.dynamics.model import Model
from tenscontrol.integrate.integrator import Work
from tenscontrol.integrate.methods import Choice
from tenscontrol.properties import cached_property
from tenscontrol.simulation.arguments import Arguments, Unsaved
from tenscontrol.simulation.contacts import ContactRecord
from tenscontrol.simulation.control_record import ControlRecord
from tenscontrol.simulation.faults import Fault
from tenscontrol.simulation.health import ERROR_LIMIT, Health
from tenscontrol.simulation.motion_functions import (
    MotionFunctions,
    by_node,
    distances,
    read_only,
)
from tenscontrol.simulation.run_table import data_frame, write_table
from tenscontrol.simulation.strut_record import StrutRecord
from tenscontrol.structure.bar_clearance import BarClearance, BarCrossing, BarMotion
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import moving_mass
from tenscontrol.viewable import Viewable

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


@dataclass(frozen=True, eq=False)
class Trajectory(Viewable):
    """A simulated motion. Made by :func:`simulate`.

    Energies, momenta, force densities and bar-length errors are evaluated when they are first read,
    and kept.

    Attributes
    ----------
    structure : Structure
    time : ndarray, shape (T,)
        s, from 0, or from the end of the run that it goes on from.
    nodes, velocities : ndarray, shape (d, n, T)
        m and m/s, in space (d = 3) or in the plane (d = 2).
    rest_length : ndarray, shape (α, T), or None
        Rest lengths, m; None where γ was held. A string that is cut has one of a
        million sizes of the structure.
    choice : Choice
        The integration method, its step or tolerance, and why it was chosen.
    work : Work
        Steps, rejections, evaluations of the right-hand side, switches.
    conserves_energy : bool
        Whether nothing takes or gives energy but strings that are cut and the ground: no damping,
        no controller, no input, load or support that changes in time.
    conserves_momentum : bool
        Whether nothing holds or pushes the structure from outside.
    control : ControlRecord or None
        Commands and moves of the winches; None in open loop.
    released_energy : ndarray, shape (T,)
        What strings stored that have been cut before each time, J: lost with them.
    stopped : str or None
        Why the motion ends early; None where it does not.
    error : ndarray, shape (T,), or None
        Estimate of the error of the nodes at each time, as part of the size: of the node that is
        off most. It is the difference from the same motion at another resolution, with a copy of
        the controller in the loop, so that it sees what magnifies errors. Commands of a function
        are replayed. Infinite from where the other motion could not go on. None where it was left
        out, or the run ended early.
    error_limit : float
        Limit on the error, as part of the size, up to which the motion is trusted.
    faults : tuple of Fault
        What was made to break.
    note : str or None
        What was put right at the start, and in which intervals functions of time were sampled.
    given : Arguments
        What :func:`simulate` was given in open loop, by name: ``rest_length`` or
        ``force_density``, ``external_force``, ``support_motion``, ``bar_length``.
    contacts : ContactRecord or None
        What touched the ground; None without ground.
    struts : StrutRecord or None
        Bars whose lengths are driven; None where all have those of the structure.
    scene : Scene or None
        What was simulated. None in a copy, in a run from a file or a batch, and in one that goes on
        from another.
    falls : bool
        Whether nothing stops it: it has weight, but neither ground nor supports.
    """

    structure: Structure
    time: FloatArray
    nodes: FloatArray
    velocities: FloatArray
    rest_length: FloatArray | None
    choice: Choice
    work: Work
    conserves_energy: bool
    conserves_momentum: bool
    control: ControlRecord | None
    released_energy: FloatArray
    stopped: str | None = None
    error: FloatArray | None = None
    error_limit: float = ERROR_LIMIT
    faults: tuple[Fault, ...] = ()
    note: str | None = None
    contacts: ContactRecord | None = None
    struts: StrutRecord | None = None
    falls: bool = False
    given: Arguments = field(default_factory=Arguments)
    scene: Any = field(default=None, repr=False)
    _ground: tuple[ContactLaw, ...] | Unsaved = ()
    # Of a copy there are none; of a run from a file they may not be there.
    _functions: MotionFunctions | Unsaved | None = field(default=None, repr=False)

    @property
    def method(self) -> str:
        """Name of the integration method that the run began with; see ``choice.methods``."""
        return self.choice.method

    @property
    def step(self) -> float | None:
        """The step asked for, s, shortened to fill spans; None where the integrator chose."""
        return self.choice.value if self.choice.setting == "step" else None

    @property
    def steps(self) -> int:
        """Number of steps."""
        return self.work.steps

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the right-hand side."""
        return self.work.evaluations

    @property
    def trusted_until(self) -> float | None:
        """Time up to which the error stays below its limit, s; None where it was not estimated."""
        if self.error is None:
            return None
        above = (self.error > self.error_limit).nonzero()[0]
        return float(self.time[above[0] - 1] if len(above) else self.time[-1])

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and copy with all that has not been evaluated yet, and without the model."""
        from tenscontrol.simulation.run_file import EVALUATED, OF_BARS

        for name in (*EVALUATED, *OF_BARS):
            getattr(self, name)
        return {name: v for name, v in vars(self).items() if name != "_bars"} | {
            "_functions": None,
            "scene": None,
        }

    @property
    def _of_model(self) -> MotionFunctions:
        assert isinstance(self._functions, MotionFunctions)  # a copy without it has all values
        return self._functions

    @property
    def model(self) -> Model:
        """The model that was simulated.

        Raises a ValueError where it has a string law or a ground of your own and the run is from a
        file, or where the run is a copy.
        """
        if isinstance(self._functions, MotionFunctions):
            return self._functions.model
        raise ValueError(str(self._functions or "a copy of a run has no model: use your own"))

    @property
    def ground(self) -> tuple[ContactLaw, ...]:
        """The contact laws of the ground; empty where there is none.

        Raises a ValueError where one is of your own and the run is from a file.
        """
        if isinstance(self._ground, Unsaved):
            raise ValueError(str(self._ground))
        return self._ground

    @cached_property
    def force_density(self) -> FloatArray:
        """γ that acts at the end of the step to each time, N/m, shape (α, T)."""
        if self.rest_length is None:
            return self._of_model.inputs
        return self._evaluated("string_force_density", self._of_model.inputs)[0]

    @cached_property
    def tension(self) -> FloatArray:
        """Tension of each string, γ times its length, N, shape (α, T)."""
        of = self.structure.segment_string
        length = np.zeros(self.force_density.shape)
        np.add.at(length, of, distances(self.nodes, self.structure.segments))
        return read_only(self.force_density * length)

    @cached_property
    def bar_force_density(self) -> FloatArray:
        """λ of each bar, N/m, shape (β, T), positive in compression: eq. (16) at each time.

        Raises a ValueError in a copy, where the model is not there, and where supports move.
        """
        model, functions = self.model, self._of_model
        if functions.moved:
            raise ValueError("forces of bars are not found in a run whose supports move")
        if self.struts is not None:
            return read_only(self.struts.force / self.struts.length)
        free, count = model.structure.free, len(self.time)
        columns = [array[:, free] for array in (self.nodes, self.velocities)]
        if model.has_external_force:
            load = functions.load
            if load is None:
                load = np.zeros(self.nodes.shape[:2])
            if load.shape != self.nodes.shape[:2]:
                load = load.reshape(*self.nodes.shape[1::-1], count).swapaxes(0, 1)
            else:
                load = np.broadcast_to(load[:, :, None], self.nodes.shape)
            columns.append(load[:, free] - model.constant_force[:, free, None])
        motion, velocities, *more = (by_node(column) for column in columns)
        function = model.prepared.get("bar forces", lambda: _of_columns(model.bar_force_density))
        return read_only(
            evaluate_columns(function, motion, velocities, self.force_density, *more)[0]
        )

    @cached_property
    def bar_force(self) -> FloatArray:
        """Force along each bar, N, shape (β, T), positive in compression: λ times the length.

        Raises as :attr:`bar_force_density` does.
        """
        if self.struts is not None:
            return self.struts.force
        length = self.structure.bar_length[:, None]  # not the drifted one: bars are rigid
        return read_only(self.bar_force_density * length)

    @cached_property
    def kinetic_energy(self) -> FloatArray:
        """½ tr(Ṅ M_s Ṅᵀ), J, shape (T,)."""
        return self._of_model.kinetic_energy(self.nodes, self.velocities)

    @cached_property
    def potential_energy(self) -> FloatArray:
        """J, shape (T,).

        It is ½ Σ γ l² where γ is held, the elastic energy of the strings where rest lengths are,
        less ``tr(Wᵀ N)`` where weights or a load act, with what is held and the load at the time.
        It jumps where a controller changes its command, and falls where a string is cut.
        """
        name = "potential_energy" if self.rest_length is None else "elastic_energy"
        return self._of_model.potential_energy(name, self.nodes, self.velocities)

    @property
    def momentum(self) -> FloatArray:
        """Linear momentum, kg m/s, shape (3, T); in the plane (2, T)."""
        return self._momenta[0]

    @property
    def angular_momentum(self) -> FloatArray:
        """Angular momentum about the origin, kg m²/s, shape (3, T); in the plane (1, T)."""
        return self._momenta[1]

    @cached_property
    def _momenta(self) -> list[FloatArray]:
        return self._evaluated("momentum")

    @cached_property
    def bar_length_error(self) -> FloatArray:
        """Current length less true length of each bar, m, shape (β, T): driven bars have L(t)."""
        error = distances(self.nodes, self.structure.bars)
        error -= self.structure.bar_length[:, None] if self.struts is None else self.struts.length
        return read_only(error)

    @cached_property
    def _bars(self) -> BarMotion:
        """The bars over the run; :func:`simulate` gives one that may have been integrated again."""
        states = self.time, self.nodes, self.velocities
        return BarMotion(self.structure, *states, steps=self.work.steps)

    @cached_property
    def bar_crossings(self) -> tuple[BarCrossing, ...] | None:
        """Bars that pass through each other; see :class:`Health`."""
        return self._bars.crossings if self._bars.has_pairs else None

    @cached_property
    def bar_clearance(self) -> BarClearance | None:
        """Least distance between the axes of two bars; see :class:`Health`."""
        return self._bars.clearance

    @cached_property
    def unresolved_intervals(self) -> int:
        """Number of intervals between outputs in which bars may cross unseen."""
        return self._bars.unresolved

    def _evaluated(self, name: str, *more: FloatArray) -> list[FloatArray]:
        return self._of_model.of(name, self.nodes, self.velocities, *more)

    @property
    def health(self) -> Health:
        """Figures that tell whether to trust the motion."""
        return self.health_of([field.name for field in fields(Health)])

    def health_of(self, names: Container[str]) -> Health:
        """Return some figures of :attr:`health`, None for those that are left out.

        Parameters
        ----------
        names : collection of str
            Fields of :class:`Health` to find, of those that take an evaluation of the model;
            the others are always there.
        """
        finds_energy = self.conserves_energy and "energy_error" in names
        kept = self._conservation(finds_energy)
        energy: float | None = None
        if finds_energy:
            # Near rest hardly any energy is kinetic: a millionth of all is then the measure.
            energy = _share(kept.change, max(kept.kinetic, 1e-6 * kept.energy))
        changes: dict[str, float | None] = {}
        parts = ("momentum", "angular_momentum") if self.conserves_momentum else ()
        for i, quantity in enumerate(parts):
            if f"{quantity}_change" in names:
                values, largest = getattr(self, quantity), self._largest_momenta()[i]
                off = float(np.abs(values - values[:, :1]).max())
                changes[f"{quantity}_change"] = _share(off, largest)
        return Health(
            energy_error=energy,
            momentum_change=changes.get("momentum_change"),
            angular_momentum_change=changes.get("angular_momentum_change"),
            bar_length_error=kept.stretch,
            position_error=None if self.error is None else float(self.error.max()),
            trusted_until=self.trusted_until,
            work=self.work,
            fall=self._fall,
            rest_length_error=self._rest_length_error,
            crossings=self.bar_crossings if "crossings" in names else None,
            clearance=self.bar_clearance if "clearance" in names else None,
            unresolved_intervals=self.unresolved_intervals if "crossings" in names else 0,
            **({} if self.contacts is None else self._of_ground(self.contacts)),
        )

    def _conservation(self, finds_energy: bool) -> Conservation:
        """Return how well bars are kept, and energy: what was lost is no error."""
        functions, struts = self._functions, self.struts
        if finds_energy and isinstance(functions, MotionFunctions):
            is_lost = self.contacts is not None or self.faults
            if functions.core is not None and functions.load_is_held and not (is_lost or struts):
                motion = self.nodes, self.velocities
                return functions.core.conservation(*motion, functions.inputs, functions.load)
        true = self.structure.bar_length[:, None] if struts is None else struts.length
        stretch = float((np.abs(self.bar_length_error) / true).max(initial=0.0))
        if not finds_energy:
            return Conservation(stretch=stretch)
        energy = self.energy
        balance = energy + self.released_energy + self.lost_energy
        change = float(np.abs(balance - balance[0]).max())
        return Conservation(
            float(self.kinetic_energy.max()), float(np.abs(energy).max()), change, stretch
        )

    @property
    def _rest_length_error(self) -> float | None:
        """The error of rest lengths that motors set, as part of the size."""
        if self.control is None or self.control.motors is None:
            return None
        size = self.structure.size
        return self.control.motors.rest_length_error / size

    def _of_ground(self, contacts: ContactRecord) -> dict[str, float | None]:
        """Return the figures of health that there are with a ground."""
        off, size = contacts.impulse_error, self.structure.size
        return {
            "penetration": contacts.penetration / size,
            "damping_work": float(contacts.damping_work[:, -1].sum()),
            "friction_work": float(contacts.friction_work[:, -1].sum()),
            "impulse": contacts.largest_impulse,
            "impulse_error": None if off is None else _share(off, self._largest_momenta()[0]),
        }

    @property
    def _fall(self) -> float | None:
        if not self.falls:
            return None
        height = self.nodes[-1, :, -1]
        fall = -float(np.add.reduce(height)) / len(height) / self.structure.size
        return fall if fall > 1 else None

    def _largest_momenta(self) -> tuple[float, float]:
        """Return the largest linear and angular momentum that the mass could have, as scales."""
        energy = self.kinetic_energy.max()
        momentum = float(np.sqrt(2 * moving_mass(self.structure) * energy))
        centre = self.nodes.mean(axis=1, keepdims=True)
        return momentum, momentum * float(np.abs(self.nodes - centre).max())

    @property
    def held(self) -> FloatArray:
        """What was held at the end, shape (α,): rest lengths, m, or γ, N/m."""
        held = self.force_density if self.rest_length is None else self.rest_length
        return np.asarray(held[:, -1])

    @property
    def energy(self) -> FloatArray:
        """Kinetic and potential energy together, J, shape (T,)."""
        return self.kinetic_energy + self.potential_energy

    @property
    def lost_energy(self) -> FloatArray:
        """Energy lost to damping and friction of the ground before each time, J, shape (T,)."""
        return np.zeros(len(self.time)) if self.contacts is None else self.contacts.lost_energy

    def summary(self) -> str:
        """Return the figures that tell whether to trust the motion, as text.

        Returns
        -------
        str
        """
        step = f"{self.choice.setting} {self.choice.value:g}" + " s" * (self.step is not None)
        drift = np.abs(self.bar_length_error).max(initial=0.0)
        momentum = np.ptp(self.momentum, axis=1).max()
        angular = np.ptp(self.angular_momentum, axis=1).max()
        methods = ", then ".join(self.choice.methods)
        lines = [
            f"{self.time[-1]:g} s by {methods}, {step}: {self.steps} steps, "
            f"{self.evaluations} evaluations",
            *self._details(),
            f"energy            {self.energy[0]:.6g} J at start, {self.energy[-1]:.6g} J at end",
            f"momentum change   {momentum:.1e} kg m/s, angular {angular:.1e} kg m^2/s",
            f"bar-length error  {drift:.1e} m",
        ]
        if self.control is not None:
            counts = ", ".join(
                f"{count} {name}"
                for kind in (self.control.status_count, self.control.fallback_count)
                for name, count in kind.items()
            )
            lines.append(f"commands          {counts}")
            if self.control.estimate is not None:
                counts = ", ".join(
                    f"{count} {name}" for name, count in self.control.estimate.status_count.items()
                )
                lines.append(f"measurements      {counts}")
            slow = int((self.control.rate_limited > 0).sum())
            out = int((self.control.range_limited > 0).sum())
            if slow or out:
                lines.append(f"winches           too slow in {slow} samples, out of range in {out}")
            motors = self.control.motors
            if motors is not None:
                torque, power = (np.abs(history).max() for history in (motors.torque, motors.power))
                given, error = motors.energy[:, -1].sum(), motors.energy_error
                lines.append(
                    f"motors            at most {torque:.3g} N m and {power:.3g} W, "
                    f"{given:.4g} J in all (to {error:.0e} J)"
                )
                if motors.rest_length_error:
                    lines[-1] += f", rest lengths to {motors.rest_length_error:.0e} m"
                weak = int((motors.torque_limited > 0).sum())
                if weak:
                    lines.append(f"                  at their limit of torque in {weak} samples")
        return "\n".join(lines)

    def _details(self) -> list[str]:
        """Return the lines that appear only where they apply."""
        lines = []
        if self.stopped is not None:
            lines.append(f"ended early       {self.stopped}")
        if self.note is not None:
            lines.append(f"note              {self.note}")
        for fault in self.faults:
            until = "" if np.isinf(fault.end) else f" to {fault.end:g} s"
            lines.append(f"fault             {fault.label} from {fault.start:g} s{until}")
        if self.choice.reason != "asked for":
            lines.append(f"method            {self.choice.reason}")
        for change in self.choice.changes:
            lines.append(f"from {change.time:<12g} {change.method}: {change.reason}")
        if self.choice.back_end != "core":
            lines.append(f"steps run in      {self.choice.back_end}")
        if self.error is not None:
            lines.append(f"position error    {self.error.max():.1e} of the size, estimated")
        if self.trusted_until is not None and self.trusted_until < self.time[-1]:
            lines.append(
                f"trusted until     {self.trusted_until:.4g} s: error below {self.error_limit:g}"
            )
        return lines + self._events()

    def _events(self) -> list[str]:
        """Return the lines on switches, contacts, bars and falls, where there are some."""
        lines = []
        if self.work.rejections:
            lines.append(f"rejected steps    {self.work.rejections}")
        if self.work.switches:
            events = "switches" if self.contacts else "slack or taut"
            lines.append(f"{events:18}{self.work.switches} times")
        if self.contacts is not None:
            lines += self.contacts.summary().splitlines()
        if self.struts is not None:
            lines.append(self.struts.summary())
        if self.bar_crossings:
            first = self.bar_crossings[0]
            times, (i, j) = len(self.bar_crossings), first.bars
            often = f"{times} times, first" if times > 1 else "once,"
            lines.append(f"bars cross        {often} {i} and {j} at {first.time:.4g} s")
        if self.unresolved_intervals:
            lines.append(
                f"bars not seen     in {self.unresolved_intervals} of {len(self.time) - 1} "
                "intervals: output_step is too long"
            )
        if (fall := self._fall) is not None:
            lines.append(f"fell              {fall:.2g} sizes below z = 0: there is no ground")
        if self.work.missed:
            lines.append(f"not located       {self.work.missed} switches more, within a step")
        return lines

    def save(self, path: str | Path) -> Path:
        """Write the run to a file, from which :func:`load_run` makes an equal one.

        Parameters
        ----------
        path : str or Path
            Its name ends in ``.npz``.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ValueError
            If the name has another ending.
        OSError
            If the file cannot be written: one that was there is as it was.

        Notes
        -----
        The file is a NumPy archive without pickles. ``numpy.load(path)`` reads its arrays, which
        have the names of the attributes: ``nodes``, ``structure_bars``, ``control_command``.
        The array ``header`` is JSON, in bytes of UTF-8. Functions and classes of your own are named
        in it, and not written: loads over time as a function, string laws, grounds.

        Examples
        --------
        >>> import tempfile, tenscontrol as tc
        >>> ball = tc.library.six_bar_ball()
        >>> run = tc.simulate(tc.Model(ball), 0.1, force_density=20.0, step=1e-2)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = run.save(folder + "/run.npz")
        ...     tc.load_run(file)
        Trajectory(0.1 s, 11 states, rk4)
        """
        from tenscontrol.simulation.run_file import EVALUATED, OF_BARS, model_parts, write_run

        values = {
            item.name: getattr(self, item.name) for item in fields(self) if item.name != "scene"
        }
        ground, functions = values.pop("_ground"), values.pop("_functions")
        more: dict[str, Any] = {"model": functions, "moved": False, "load": None}
        if isinstance(functions, MotionFunctions):
            parts = model_parts(functions.model)
            more = {"model": parts, "moved": functions.moved, "load": functions.load}
        evaluated = {name: getattr(self, name) for name in (*EVALUATED, *OF_BARS)}
        return write_run(path, {**values, "ground": ground, **more, **evaluated})

    def to_csv(self, path: str | Path) -> Path:
        """Write the motion as CSV: a line a time, with full precision.

        Columns are time, node coordinates, γ, tension and rest length of the strings, and, under a
        controller, the command that acted in the step to each time. The first line has names and
        units. Rest lengths are left out where γ was held.

        Parameters
        ----------
        path : str or Path

        Returns
        -------
        Path
            The file.

        Raises
        ------
        OSError
            If the file cannot be written: one that was there is as it was.
        """
        return write_table(self, path)

    def to_pandas(self) -> DataFrame:
        """Return the motion as a frame of pandas: one row a time, the columns of :meth:`to_csv`.

        Returns
        -------
        pandas.DataFrame
            Its index is the time, s. Each column has its unit in its name.

        Raises
        ------
        ImportError
            If pandas is not installed: ``pip install 'tenscontrol[pandas]'``.

        Examples
        --------
        >>> import tenscontrol as tc
        >>> run = tc.simulate(tc.Model(tc.prism()), 0.1, force_density=10.0, step=1e-2)
        >>> frame = run.to_pandas()
        >>> frame.shape, frame.columns[0], frame.index.name
        ((11, 36), 'node 0 x [m]', 'time [s]')
        """
        return data_frame(self)

    def to_xarray(self) -> Dataset:
        """Return the motion as a dataset of xarray, which labels axes and units.

        Dimensions are ``time``, ``axis``, ``node``, ``string`` and ``bar``; of a controller
        ``sample`` and ``winch``. Each variable has its unit as the attribute ``units``. Its
        ``to_dataframe`` refuses a table of more than 20 million rows: see :meth:`to_pandas`.

        Returns
        -------
        xarray.Dataset

        Raises
        ------
        ImportError
            If xarray is not installed: ``pip install 'tenscontrol[xarray]'``.
        """
        try:
            from tenscontrol.simulation.run_dataset import dataset
        except ImportError as error:
            raise ImportError(
                "to_xarray needs the package xarray, which is not installed: "
                "pip install 'tenscontrol[xarray]'"
            ) from error
        return dataset(self)

    def __repr__(self) -> str:
        return f"Trajectory({self.time[-1]:g} s, {len(self.time)} states, {self.method})"


def _share(change: float, scale: float) -> float:
    return change / scale if scale > 0 else change


def load_run(path: str | Path) -> Trajectory:
    """Return the run of a file that :meth:`Trajectory.save` wrote.

    It plots, summarizes and goes on (``simulate(run.model, ..., start=run)``) as the saved one
    does, and its arrays are equal bit by bit.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Trajectory

    Raises
    ------
    TypeError
        If ``path`` is no path.
    OSError
        If the file cannot be read.
    ValueError
        If it is no run, was written by a later release, is damaged, or has arrays that do not fit
        each other or are not finite. The message names the file.

    Notes
    -----
    A string law, a ground or a function of your own is not in the file. Where one was used,
    ``run.model``, ``run.ground`` or ``run.given[name]`` raises a ValueError that names it; the
    motion and all that was evaluated from it are there.

    Examples
    --------
    >>> import tempfile, tenscontrol as tc
    >>> ball = tc.library.six_bar_ball()
    >>> model = tc.Model(ball, gravity=9.81, ground=tc.Ground(stiffness=5e3, height=-1.0))
    >>> run = tc.simulate(model, 0.1, force_density=20.0, step=1e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     saved = tc.load_run(run.save(folder + "/run.npz"))
    >>> bool((saved.nodes == run.nodes).all()), saved.summary() == run.summary()
    (True, True)
    >>> more = tc.simulate(saved.model, 0.1, start=saved, step=1e-3)
    >>> more.time[[0, -1]].round(3)
    array([0.1, 0.2])
    """
    from tenscontrol.simulation.run_file import EVALUATED, OF_BARS, read_run

    saved = read_run(path)
    evaluated = {name: saved.pop(name) for name in (*EVALUATED, *OF_BARS)}
    evaluated["_momenta"] = [evaluated.pop(name) for name in ("momentum", "angular_momentum")]
    ground, functions, moved, load = (
        saved.pop(name) for name in ("ground", "model", "moved", "load")
    )
    if isinstance(functions, Model):
        lengths, contacts = saved["rest_length"], saved["contacts"]
        inputs = evaluated["force_density"] if lengths is None else lengths
        stored = None if contacts is None else contacts.stored_energy.sum(axis=0)
        functions = MotionFunctions(functions, moved, inputs, load, stored)
    run = Trajectory(**saved, _ground=ground, _functions=functions)
    vars(run).update(evaluated)
    return run


def _of_columns(function: ca.Function) -> ca.Function:
    """Return a function whose arguments are columns, in place of matrices."""
    shapes = [function.size_in(i) for i in range(function.n_in())]
    columns = [ca.MX.sym(f"column{i}", m * n) for i, (m, n) in enumerate(shapes)]
    matrices = [ca.reshape(c, *shape) for c, shape in zip(columns, shapes, strict=True)]
    return Function("of_columns", columns, [ca.densify(function(*matrices))])
