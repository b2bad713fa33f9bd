"""Trajectories of simulations, their control records, and figures of their accuracy."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np

from tenscontrol.actuation import MotorRecord
from tenscontrol.control import UNSOLVED, Fallback, Status
from tenscontrol.dynamics import ContactLaw
from tenscontrol.integrate import Choice, Work
from tenscontrol.simulation.contacts import ContactRecord, drawn_ground
from tenscontrol.simulation.faults import Fault
from tenscontrol.simulation.health import BLOCK, Health, Quantities, by_node, read_only
from tenscontrol.simulation.observation import EstimateRecord
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray
from tenscontrol.web_page import View, Viewable

# A run ends away from its reference: by this part of the size, with errors in the last third above
# this part of those before, if it lasts so many radians of the slowest vibration. Or
# by the fourth, and so many times the error at the start.
_AWAY, _FALLING, _TURNED, _LOST, _WORSE = 0.02, 0.9, 4 * np.pi, 0.2, 1.2

# More programs not solved than this are worth a warning.
_UNSOLVED_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class ControlRecord:
    """Commands and moves of the winches, sample by sample.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Start of each sample, s.
    command : ndarray, shape (α, K)
        Desired input, in the unit of the controller.
    applied : ndarray, shape (α, K)
        Applied input: γ, N/m, or rest lengths, m, one a string of the controller;
        of a ramp, its end.
    status : tuple of Status, length K
        Status of each command; ``Status.OK`` where all went well.
    fallback : tuple, length K
        Fallback of each command, None where there was a decision.
    detail : tuple of str, length K
        Figures to the status.
    winch_rate : ndarray, shape (α, K)
        Change of the rest length in each sample over the sample time, m/s;
        zero where γ is held. The first counts from the start, if that is known.
    rate_limited, range_limited : ndarray of int, shape (K,)
        Number of winches that met a limit.
    computing_time : ndarray, shape (K,)
        Time the controller took, s.
    estimate : EstimateRecord or None
        Measurements and estimates; None without an estimator.
    motors : MotorRecord or None
        Angle, speed, torque, power and energy; None where the winches have no motor.
    prediction_error : ndarray, shape (K,), or None
        How far the node that was off most was from where the controller had predicted it a sample
        before, m. NaN where nothing was predicted, or nothing measured; None where that is so
        throughout.
    tracking_error : ndarray, shape (K + 1,), or None
        Distance of the node that is farthest off its place in the reference of the controller, at
        the start of each sample and at the end of the run, m. The shape is first laid over that
        of the plant by what supports leave of rigid-body motion. None where the controller has
        no reference.
    at_bound : ndarray of int, shape (K,), or None
        Number of strings commanded at a bound of the controller, or of its change.
    controller : str
        What it was.
    sample_time : float or None
        s.
    size : float or None
        Largest extent of the structure, m.
    slowest_vibration : float or None
        Of the controller's plant, 1/s.
    """

    time: FloatArray
    command: FloatArray
    applied: FloatArray
    status: tuple[Status, ...]
    fallback: tuple[Fallback | None, ...]
    detail: tuple[str, ...]
    winch_rate: FloatArray
    rate_limited: np.ndarray
    range_limited: np.ndarray
    computing_time: FloatArray
    estimate: EstimateRecord | None = None
    motors: MotorRecord | None = None
    prediction_error: FloatArray | None = None
    tracking_error: FloatArray | None = None
    at_bound: np.ndarray | None = None
    controller: str = ""
    sample_time: float | None = None
    size: float | None = None
    slowest_vibration: float | None = None

    @property
    def unsolved(self) -> float:
        """Fraction of the samples whose program was not solved."""
        return sum(status in UNSOLVED for status in self.status) / len(self.status)

    @property
    def problems(self) -> list[str]:
        """A sentence for what went wrong; empty where the run did what was asked.

        The run ends away from the reference: by more than 2 % of the size in its last tenth, with
        errors in the last third of more than 0.9 of the largest of those in the second, after two
        turns of the slowest vibration of the plant. Or by more than a fifth of the size, and 1.2
        times as far as it began. Programs were not solved: more than one in twenty.
        """
        found, error = [], self.tracking_error
        if error is not None and self.size is not None and self.slowest_vibration is not None:
            off = error / self.size
            end = float(off[-max(1, len(off) // 10) :].max())
            third = max(1, len(off) // 3)
            long = float(self.time[-1] - self.time[0]) * self.slowest_vibration > _TURNED
            stays = long and off[-third:].max() > _FALLING * off[-2 * third :].max()
            if (end > _AWAY and stays) or end > max(_LOST, _WORSE * float(off[0])):
                found.append(
                    f"it ends up to {end * self.size:.2g} m from its reference, {100 * end:.2g} % "
                    "of the size, and comes no nearer"
                )
        if self.unsolved > _UNSOLVED_SHARE:
            worst = Counter(status for status in self.status if status in UNSOLVED).most_common(1)
            found.append(
                f"{100 * self.unsolved:.2g} % of the programs were not solved, most of them "
                f"{worst[0][0]}"
            )
        return found

    def summary(self) -> str:
        """Return a summary of the closed loop, as text: status, errors, computing time.

        Returns
        -------
        str

        Examples
        --------
        >>> import tenscontrol as tc
        >>> prism = tc.prism()
        >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
        >>> plant = tc.linearize(model, tc.prestress(prism, 17.3205), input="rest_length")
        >>> start = plant.to_nodes([0.02] * 9)
        >>> mpc = tc.MPC(plant, horizon=10, sample_time=0.02)
        >>> run = tc.simulate(model, 3.0, start, controller=mpc, step=1e-3)
        >>> print(run.control.summary())  # doctest: +ELLIPSIS
        controller        MPC(... horizon 10, sample time 0.02 s, condensed, daqp)
        samples           150 of 0.02 s: 150 ok
        tracking error    0.00... m at the end, 0.00... m rms (0.2... % and 0.9... % of the size)
        prediction error  ...e-05 m rms, 0.0005... m at most
        at a bound        0 % of the samples
        computing time    ... ms in the median, ... ms at most: ... % of a sample
        """
        counts = ", ".join(
            f"{count} {name}"
            for kind in (self.status_count, self.fallback_count)
            for name, count in kind.items()
        )
        lines = [f"samples           {len(self.time)}: {counts}"]
        if self.sample_time is not None:
            lines = [
                f"controller        {self.controller}",
                f"samples           {len(self.time)} of {self.sample_time:g} s: {counts}",
            ]
        if self.unsolved:
            lines.append(f"not solved        {100 * self.unsolved:.2g} % of the samples")
        if self.tracking_error is not None and self.size is not None:
            end, rms = float(self.tracking_error[-1]), _rms(self.tracking_error)
            lines.append(
                f"tracking error    {end:.2g} m at the end, {rms:.2g} m rms "
                f"({100 * end / self.size:.2g} % and {100 * rms / self.size:.2g} % of the size)"
            )
        if self.prediction_error is not None and np.isfinite(self.prediction_error).any():
            off = self.prediction_error[np.isfinite(self.prediction_error)]
            lines.append(f"prediction error  {_rms(off):.2g} m rms, {off.max():.2g} m at most")
        if self.at_bound is not None:
            share = np.count_nonzero(self.at_bound) / len(self.at_bound)
            lines.append(f"at a bound        {100 * share:.2g} % of the samples")
        slow, out = (int((each > 0).sum()) for each in (self.rate_limited, self.range_limited))
        if slow or out:
            lines.append(f"winches           too slow in {slow} samples, out of range in {out}")
        typical, worst = float(np.median(self.computing_time)), float(self.computing_time.max())
        lines.append(
            f"computing time    {1e3 * typical:.2g} ms in the median, {1e3 * worst:.2g} ms"
        )
        lines[-1] += " at most"
        if self.sample_time is not None:
            lines[-1] += f": {100 * worst / self.sample_time:.2g} % of a sample"
        return "\n".join(lines)

    @property
    def status_count(self) -> dict[Status, int]:
        """How often each status came."""
        return dict(Counter(self.status))

    @property
    def fallback_count(self) -> dict[Fallback, int]:
        """How often each fallback was taken."""
        return dict(Counter(fallback for fallback in self.fallback if fallback is not None))


# What a trajectory evaluates when it is first read.
_EVALUATED = ("force_density", "kinetic_energy", "potential_energy", "_momenta", "bar_length_error")


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
    position_error : float or None
        Estimate of the error of the nodes at the end, as part of the size: by step doubling over
        parts of the motion; with a tolerance, that times the steps; and of ``energy_momentum``, by
        where impulses of the ground leave the centre of mass. None where few states were kept, or
        the motion ends early. Motions that magnify errors need :func:`predictability`.
    faults : tuple of Fault
        What was made to break.
    note : str or None
        What was put right at the start.
    ground : tuple of ContactLaw
    contacts : ContactRecord or None
        What touched the ground; None without ground.
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
    position_error: float | None = None
    faults: tuple[Fault, ...] = ()
    note: str | None = None
    ground: tuple[ContactLaw, ...] = ()
    contacts: ContactRecord | None = None
    falls: bool = False
    _quantities: Quantities | None = field(default=None, repr=False)

    @property
    def method(self) -> str:
        """Name of the integration method."""
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

    def __getstate__(self) -> dict[str, Any]:
        """Pickle and copy with all that has not been evaluated yet, and without the model."""
        for name in _EVALUATED:
            getattr(self, name)
        return vars(self) | {"_quantities": None}

    @property
    def _of_model(self) -> Quantities:
        assert self._quantities is not None  # a copy without it has all values
        return self._quantities

    @cached_property
    def force_density(self) -> FloatArray:
        """γ that acts at the end of the step to each time, N/m, shape (α, T)."""
        if self.rest_length is None:
            return self._of_model.inputs
        return self._evaluated("string_force_density", self._of_model.inputs)[0]

    @cached_property
    def kinetic_energy(self) -> FloatArray:
        """½ tr(Ṅ M_s Ṅᵀ), J, shape (T,)."""
        energy: FloatArray = self._evaluated("kinetic_energy")[0][0]
        return energy

    @cached_property
    def potential_energy(self) -> FloatArray:
        """J, shape (T,).

        It is ½ Σ γ l² where γ is held, the elastic energy of the strings where rest lengths are,
        less ``tr(Wᵀ N)`` where weights or a load act, with what is held and the load at the time.
        It jumps where a controller changes its command, and falls where a string is cut.
        """
        name = "potential_energy" if self.rest_length is None else "elastic_energy"
        quantities = self._of_model
        energy = self._evaluated(name, quantities.inputs)[0][0]
        if quantities.stored is not None:
            energy = energy + quantities.stored
        if quantities.load is not None:
            fixed = quantities.load.shape == self.nodes.shape[:2]
            energy = energy - (
                np.einsum("in,int->t", quantities.load, self.nodes)
                if fixed
                else (quantities.load * by_node(self.nodes)).sum(axis=0)
            )
        return read_only(energy)

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
        """Current length less true length of each bar, m, shape (β, T)."""
        start, end = self.structure.bars.T
        error = np.empty((len(start), len(self.time)))
        for first in range(0, len(self.time), BLOCK):
            some = slice(first, first + BLOCK)
            bars = self.nodes[:, end, some] - self.nodes[:, start, some]
            error[:, some] = np.linalg.norm(bars, axis=0)
        error -= self.structure.bar_length[:, None]
        return read_only(error)

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
        energy: float | None = None
        if self.conserves_energy and "energy_error" in names:
            # What was lost is no error.
            balance = self.energy + self.released_energy + self.lost_energy
            moved = float(np.abs(balance - balance[0]).max())
            # Near rest hardly any energy is kinetic: a millionth of all is then the measure.
            least = 1e-6 * float(np.abs(self.energy).max())
            energy = _share(moved, max(float(self.kinetic_energy.max()), least))
        changes: dict[str, float | None] = {}
        parts = ("momentum", "angular_momentum")
        for i, part in enumerate(parts):
            if self.conserves_momentum and f"{part}_change" in names:
                values, largest = getattr(self, part), self._largest_momenta()[i]
                off = float(np.abs(values - values[:, :1]).max())
                changes[f"{part}_change"] = _share(off, largest)
        stretch = np.abs(self.bar_length_error) / self.structure.bar_length[:, None]
        return Health(
            energy_error=energy,
            momentum_change=changes.get("momentum_change"),
            angular_momentum_change=changes.get("angular_momentum_change"),
            bar_length_error=float(stretch.max(initial=0.0)),
            position_error=self.position_error,
            work=self.work,
            fall=self._fall,
            **({} if self.contacts is None else self._of_ground(self.contacts)),
        )

    def _of_ground(self, found: ContactRecord) -> dict[str, float | None]:
        """Return the figures of health that there are with a ground."""
        off, size = found.impulse_error, float(np.ptp(self.structure.nodes, axis=1).max())
        return {
            "penetration": found.penetration / size,
            "damping_work": float(found.damping_work[:, -1].sum()),
            "friction_work": float(found.friction_work[:, -1].sum()),
            "impulse": found.largest_impulse,
            "impulse_error": None if off is None else _share(off, self._largest_momenta()[0]),
        }

    @property
    def _fall(self) -> float | None:
        fall = -float(self.nodes[-1, :, -1].mean() / np.ptp(self.structure.nodes, axis=1).max())
        return fall if self.falls and fall > 1 else None

    def _largest_momenta(self) -> tuple[float, float]:
        """Return the largest linear and angular momentum that the mass could have, as scales."""
        points = self.structure.point_mass
        mass = self.structure.bar_mass.sum() + points[points > 0].sum()
        momentum = float(np.sqrt(2 * mass * self.kinetic_energy.max()))
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
        lines = [
            f"{self.time[-1]:g} s by {self.method}, {step}: {self.steps} steps, "
            f"{self.evaluations} evaluations",
            *self._details(),
            f"energy            {self.energy[0]:.6g} J at start, {self.energy[-1]:.6g} J at end",
            f"momentum change   {momentum:.1e} kg m/s, angular {angular:.1e} kg m²/s",
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
                torque, power = (np.abs(part).max() for part in (motors.torque, motors.power))
                given, error = motors.energy[:, -1].sum(), motors.energy_error
                lines.append(
                    f"motors            at most {torque:.3g} N m and {power:.3g} W, "
                    f"{given:.4g} J in all (to {error:.0e} J)"
                )
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
            lines.append(f"start             {self.note}")
        for fault in self.faults:
            until = "" if np.isinf(fault.end) else f" to {fault.end:g} s"
            lines.append(f"fault             {fault.label} from {fault.start:g} s{until}")
        if self.choice.reason != "asked for":
            lines.append(f"method            {self.choice.reason}")
        if self.choice.back_end != "virtual machine":
            lines.append(f"steps run in      {self.choice.back_end}")
        if self.position_error is not None:
            lines.append(f"position error    {self.position_error:.1e} of the size, estimated")
        if self.work.rejections:
            lines.append(f"rejected steps    {self.work.rejections}")
        if self.work.switches:
            what = "switches" if self.contacts else "slack or taut"
            lines.append(f"{what:18}{self.work.switches} times")
        if self.contacts is not None:
            lines += self.contacts.summary().splitlines()
        if (fall := self._fall) is not None:
            lines.append(f"fell              {fall:.2g} sizes below z = 0: there is no ground")
        if self.work.unlocated:
            lines.append(f"not located       {self.work.unlocated} steps across a switch")
        return lines

    def view(self) -> View:
        """Return a view to be played in a browser.

        Returns
        -------
        View
        """
        what = f"run of {self.time[-1]:g} s by {self.method}"
        ground = drawn_ground(self.ground, self.contacts, self.nodes)
        return View(what, self.structure, self.nodes, self.time, self.force_density, **ground)

    def __repr__(self) -> str:
        return f"Trajectory({self.time[-1]:g} s, {len(self.time)} states, {self.method})"


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _share(change: float, scale: float) -> float:
    return change / scale if scale > 0 else change
