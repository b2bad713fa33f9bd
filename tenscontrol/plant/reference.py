"""Reference trajectories of controllers, with the inputs that hold their shapes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import inputs_of, member_rows, moved_by, strings_of
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.evaluator import Function, evaluate_columns
from tenscontrol.fields import Array, OptionalArray, converted
from tenscontrol.plant.linear_plant import (
    LinearPlant,
    Sampled,
    acceleration_response,
    kept,
    member_lengths,
)
from tenscontrol.plant.string_outputs import input_matrix, to_commanded_strings, to_model_strings
from tenscontrol.short_repr import short_repr
from tenscontrol.structure.bar_clearance import bar_distances
from tenscontrol.structure.bar_geometry import bar_lengths, refuse_wrong_bar_lengths
from tenscontrol.structure.supports import refuse_moved_supports

# Force densities of a reference shape may leave those of the operating point only as far as the
# balance of forces gains from it, by this fraction of the largest singular value.
_RIDGE = 1e-3

# A bar of a reference may be off by this part of its length, and a fixed node by this part of the
# size: the coordinates do not see it. Bars nearer than this part of the size touch.
_OFF, _TOUCHING = 0.01, 1e-6

# A shape given elsewhere is asked only to move as one body where nodes move by more than the first
# part of the size, or within a reference by more than the second, and change their distances by
# less than the third part of that.
_MOVED, _TRAVELLED, _UNCHANGED = 1e-6, 0.01, 1e-3

# Newton steps to the inputs that hold a shape, the part of a rest length for differences, and the
# least part of an input to which it is wound in.
_NEWTON, _STEP, _SHORTEST = 6, 1e-6, 0.1

# A reference may ask passive strings for rest lengths that are off by this part of the longest.
_PASSIVE = 1e-3

# A string can be wound up to this fraction of what its law allows.
_STRONGEST = 0.99

#: Why a place cannot be asked for.
STRINGS_MOVE_NO_CENTRE = (
    "Strings and bars exert internal forces only: they cannot move the centre of mass of a free "
    "structure, nor rotate it about that. Supports, contact with the ground and external forces "
    "can"
)


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference trajectory: shapes at given times, linear in between, constant before and after.

    Parameters
    ----------
    time : array_like, shape (K,)
        s, ascending.
    nodes : array_like, shape (d, n, K)
        Node positions at these times, m.
    force_density : array_like, shape (α, K), optional
        γ that holds the shapes, N/m, at least 0. Several γ may balance in a shape. If not given,
        controllers of rest lengths take the one nearest to their operating point. Controllers
        of γ always aim at the γ of their operating point.

    Raises
    ------
    TypeError, ValueError
        If the arrays are not finite or do not fit, or the times do not ascend.

    Examples
    --------
    A prism on its way from 1 m to 0.85 m in two seconds:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism(height=1.0)
    >>> length = prism.bar_length[0]
    >>> time = np.linspace(0.0, 2.0, 21)
    >>> shapes = [tc.prism(radius=tc.structure.prism_radius(length, h), height=h).nodes
    ...           for h in 1.0 - 0.075 * time]
    >>> tc.Reference(time, np.stack(shapes, axis=-1)).nodes.shape
    (3, 6, 21)
    """

    time: Array = converted()
    nodes: Array = converted()
    force_density: OptionalArray = converted(None)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        time = validation.vector("time", self.time)
        nodes = validation.float_array("nodes", self.nodes)
        if time.ndim != 1 or len(time) == 0:
            raise ValueError(f"time has shape {time.shape}, expected (K,) with K at least 1")
        if (np.diff(time) <= 0).any():
            k = int(np.argmax(np.diff(time) <= 0))
            raise ValueError(
                f"time[{k + 1}] is {time[k + 1]:g} s after time[{k}] = {time[k]:g} s; "
                "expected ascending times"
            )
        if nodes.ndim != 3 or nodes.shape[0] not in (2, 3) or nodes.shape[2] != len(time):
            raise ValueError(
                f"nodes has shape {nodes.shape}, expected (3, n, {len(time)}), or "
                f"(2, n, {len(time)}) in the plane: one shape per time"
            )
        if self.force_density is not None:
            gamma = validation.float_array("force_density", self.force_density)
            if gamma.ndim != 2 or gamma.shape[1] != len(time):
                raise ValueError(
                    f"force_density has shape {gamma.shape}, expected (α, {len(time)}): "
                    "one row per string, one column per time"
                )
            for i, row in enumerate(gamma):
                validation.non_negative(f"force_density[{i}]", row, "a string can only pull")
            object.__setattr__(self, "force_density", frozen(gamma))
        object.__setattr__(self, "time", frozen(time))
        object.__setattr__(self, "nodes", frozen(nodes))

    def reversed(self) -> Reference:
        """Return the same shapes the other way round: the last first, at the first time.

        Examples
        --------
        >>> import numpy as np, tenscontrol as tc
        >>> shapes = tc.prism().nodes[:, :, None] * [1.0, 0.9, 0.7]
        >>> tc.Reference([0.0, 1.0, 3.0], shapes).reversed().time
        array([0., 2., 3.])
        """
        gamma = self.force_density
        return Reference(
            self.time[0] + self.time[-1] - self.time[::-1],
            self.nodes[:, :, ::-1],
            None if gamma is None else gamma[:, ::-1],
        )

    def then(self, other: Reference, pause: float) -> Reference:
        """Return this reference, a pause, then another one.

        Parameters
        ----------
        other : Reference
            Its first time comes a pause after the last of this one.
        pause : float
            s, more than 0.

        Returns
        -------
        Reference
            With force densities if both have them. In the pause the shape goes
            straight from the last of this one to the first of the other.

        Raises
        ------
        TypeError, ValueError
            If the other is no reference or of other nodes or strings, one of the two
            alone has force densities, or the pause is not a positive number.

        Examples
        --------
        There and back, with a second of rest:

        >>> import numpy as np, tenscontrol as tc
        >>> there = tc.Reference([0.0, 2.0], tc.prism().nodes[:, :, None] * [1.0, 0.7])
        >>> there.then(there.reversed(), pause=1.0).time
        array([0., 2., 3., 5.])
        """
        validation.instance("other", other, Reference, "make one by Reference(time, nodes)")
        pause = validation.positive_number("pause", pause, "s")
        for name in ("nodes", "force_density"):
            ours, theirs = (
                None if value is None else value.shape[:-1]
                for value in (getattr(self, name), getattr(other, name))
            )
            if ours != theirs:
                raise ValueError(
                    f"other.{name} has the shape {theirs} at each time, expected {ours}, as here"
                )
        begin = self.time[-1] + pause - other.time[0]
        time = np.concatenate([self.time, begin + other.time])
        if (np.diff(time) <= 0).any():
            raise ValueError(
                f"pause is {pause:g} s, after which rounding makes times of other equal"
            )
        gamma = None
        if self.force_density is not None and other.force_density is not None:
            gamma = np.hstack([self.force_density, other.force_density])
        return Reference(time, np.concatenate([self.nodes, other.nodes], axis=-1), gamma)


class SmoothReference:
    """Clamped cubic splines through values, shape (K, p), at given times, shape (K,)."""

    def __init__(self, time: FloatArray, values: FloatArray) -> None:
        from scipy.interpolate import CubicSpline

        self._start, self._end = float(time[0]), float(time[-1])
        self._ends = values[0], values[-1]
        self._spline = CubicSpline(time, values, bc_type="clamped") if len(time) > 1 else None

    def at(self, time: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return value, rate and acceleration, shape (p,) each; still outside the times."""
        if self._spline is None or not self._start <= time < self._end:
            held = self._ends[int(time >= self._end)]
            return held, np.zeros_like(held), np.zeros_like(held)
        return self._spline(time), self._spline(time, 1), self._spline(time, 2)


@dataclass(frozen=True, eq=False)
class Preview:
    """A reference at K times, with the input that holds the plant in each shape.

    :meth:`ReferencePreview.over_horizon` gives the K = N + 1 starts of samples, but N rows of
    ``reference`` and ``drift``: r_1 … r_N, and the d_k of a state measured from the operating
    point.
    """

    reference: FloatArray  # (K, s), [q; q̇]
    rest: FloatArray  # (K, s), [q; 0]
    input: FloatArray  # (K, m), origin of v: holds the plant there
    force_density: FloatArray  # (K, α'), N/m, of the strings of the model there
    tension: FloatArray  # (K, α'), N
    drift: FloatArray  # (K, s), by which the state drifts from there in a sample all the same
    previous_input: FloatArray  # (m,), before the first sample
    start: FloatArray  # (s,), r_0, at the first time


class ReferencePreview:
    """A reference in the coordinates of a plant, with the inputs that hold its shapes.

    With γ as the input, the plant is linear about its operating point throughout. With rest
    lengths, the lengths of the strings in the shapes themselves are used: for a stiff string,
    second-order errors of its length matter.

    The reference is checked: a Reference, a shape (d, n), or None for the operating point.
    ``span`` are its first and last time, s: it is at rest before and after.
    """

    def __init__(self, plant: LinearPlant, reference: object, sampled: Sampled) -> None:
        self.given = reference is not None
        reference, q = checked_reference(plant, reference)
        r = plant.degrees_of_freedom
        self._plant, self._sampled = plant, sampled
        self.span = float(reference.time[0]), float(reference.time[-1])
        self._time, self._coordinates = reference.time, q
        # Rates between the times, zero before the first and after the last.
        slopes = np.diff(q, axis=0) / np.diff(reference.time)[:, None]
        self._rates = np.vstack([np.zeros((1, r)), slopes, np.zeros((1, r))])
        # What holds the plant in each shape, side by side, at these times, straight in between.
        self._held_time = reference.time[:1]
        self._shapes = None
        if plant.input == "force_density":
            gamma = to_model_strings(plant, "force_density", plant.force_density)
            tension = gamma * plant.model.structure.string_length(plant.nodes)
            entries = np.zeros(2 * r), plant.equilibrium_input, gamma, tension, sampled.drift
            self._table = np.concatenate(entries)[None]
        else:
            self._held_time = _refined(reference.time, sampled.sample_time)
            rests = self.wanted(self._held_time)[:, :r]
            if plant.drives_bars:
                self._shapes = reference.time, reference.nodes
                shapes = self._bar_shapes(self._held_time)
            else:
                shapes = np.array([plant.to_nodes(row) for row in rests])
            gamma = plant.force_density[:, None] * np.ones(len(self._held_time))
            if reference.force_density is not None and plant.winds_strings:
                gamma = np.array(
                    [
                        np.interp(self._held_time, reference.time, row)
                        for row in reference.force_density
                    ]
                )
                _refuse_moved_passive(plant, shapes, gamma)
            self._response = acceleration_response(plant, sampled.sample_time)
            self._table = _held(plant, rests, shapes, gamma, self._response)
        strings = len(plant.model.structure.strings)
        self._ends = np.cumsum([2 * r, plant.B.shape[1], strings, strings])
        self._damping = plant.A[r:, r:]
        self._constant: dict[int, Preview] = {}  # where the reference is one shape

    def following(self, reference: object) -> ReferencePreview:
        """Return the preview of another reference, given as to the constructor."""
        return ReferencePreview(self._plant, reference, self._sampled)

    @property
    def sample_time(self) -> float:
        """Of the controller, s."""
        return self._sampled.sample_time

    @property
    def times(self) -> FloatArray:
        """Times between which the reference and what holds it are straight, s."""
        return np.union1d(self._time, self._held_time)

    def wanted(self, times: FloatArray) -> FloatArray:
        """Return ``[q; q̇]`` of the reference, shape (K, s)."""
        right = np.searchsorted(self._time, times, side="right")
        nearest = np.clip(right - 1, 0, None)
        past = np.clip(times - self._time[nearest], 0.0, None)[:, None]
        rates = self._rates[right]
        return np.hstack([self._coordinates[nearest] + past * rates, rates])

    def nodes_at(self, times: FloatArray) -> FloatArray:
        """Return node positions of the reference at times, shape (d, n, K), m."""
        if self._shapes is not None:
            return self._bar_shapes(times).transpose(1, 2, 0)
        q = self.wanted(times)[:, : self._coordinates.shape[1]]
        rows, which = np.unique(q, axis=0, return_inverse=True)
        return np.array([self._plant.to_nodes(row) for row in rows])[which].transpose(1, 2, 0)

    def _bar_shapes(self, times: FloatArray) -> FloatArray:
        """Return shapes of a reference whose bars are driven, (K, d, n), m: straight in between."""
        assert self._shapes is not None  # bars are driven
        time, nodes = self._shapes
        right = np.clip(np.searchsorted(time, times), 1, max(len(time) - 1, 1))
        last = np.minimum(right, len(time) - 1)
        left, end = time[right - 1], time[last]
        share = np.clip((times - left) / np.where(end > left, end - left, 1.0), 0.0, 1.0)
        before, after = (np.moveaxis(nodes[:, :, k], 2, 0) for k in (right - 1, last))
        return np.asarray(before + share[:, None, None] * (after - before))

    def at(self, times: FloatArray) -> Preview:
        """Return the preview at these times, shape (K,), s."""
        if len(self._held_time) == 1:
            rows = np.tile(self._table, (len(times), 1))
        else:
            right = np.clip(np.searchsorted(self._held_time, times), 1, len(self._held_time) - 1)
            left, end = self._held_time[right - 1], self._held_time[right]
            share = np.clip((times - left) / (end - left), 0.0, 1.0)[:, None]
            rows = (1 - share) * self._table[right - 1] + share * self._table[right]
        rest, held, gamma, tension, drift = np.split(rows, self._ends, axis=1)
        wanted = self.wanted(times)
        return Preview(wanted, rest, held, gamma, tension, drift, held[0], wanted[0])

    def over_horizon(self, time: float, length: int) -> Preview:
        """Return the preview of so many samples from a time on, s.

        Inputs that are held: the plant moves about shapes at rest. Ramps: it is linear about the
        motion of the reference, along which its strings have no force to spare, and damping and
        inertia alone lead away. (About a shape at rest, a stiff string would have to be known to a
        hundredth of its stiffness.)
        """
        if len(self._time) > 1:
            return self._over_horizon(time, length)
        if length not in self._constant:
            preview = self._over_horizon(0.0, length)
            for array in vars(preview).values():
                array.setflags(write=False)
            self._constant[length] = preview
        return self._constant[length]

    def _over_horizon(self, time: float, length: int) -> Preview:
        sampled, r = self._sampled, len(self._damping)
        sample_time = sampled.sample_time
        if not sampled.ramp:
            preview = self.at(time + sample_time * np.arange(length + 1.0))
            rest = preview.rest[:-1]
            drift = rest - rest @ sampled.transition.T + preview.drift[:-1]
            return replace(preview, reference=preview.reference[1:], drift=drift)
        times = time + sample_time * np.arange(-1.0, length + 2)
        preview = self.at(times[1:])
        q = self.wanted(times)[:, :r]
        rates = (q[2:] - q[:-2]) / (2 * sample_time)
        motion = np.hstack([q[1:-1], rates])
        mean, gained = (rates[1:] + rates[:-1]) / 2, np.diff(rates, axis=0) / sample_time
        spare = mean @ self._damping.T - gained
        if self._plant.rate_input is not None:  # damped strings feel how fast bars grow
            growing = np.diff(preview.input, axis=0)[:-1] / sample_time
            spare = spare + growing @ self._plant.rate_input[r:].T
        drift = (
            motion[1:]
            - motion[:-1] @ sampled.transition.T
            + spare @ self._response.T
            + preview.drift[1:-1]
        )
        return Preview(
            reference=motion[1:],
            rest=preview.rest[1:],
            input=preview.input[1:],
            force_density=preview.force_density[1:],
            tension=preview.tension[1:],
            drift=drift,
            previous_input=preview.previous_input,
            start=motion[0],
        )


def checked_reference(
    plant: LinearPlant, reference: object, name: str = "reference", anywhere: bool = False
) -> tuple[Reference, FloatArray]:
    """Return a reference, the operating point for None, and q of its shapes, (K, r), or raise.

    ``anywhere``: the shape of the operating point in another place is one to compare with.
    """
    shape = plant.nodes.shape
    if reference is None:
        q = plant.measure(plant.nodes, np.zeros(shape))[: plant.degrees_of_freedom]
        return Reference([0.0], plant.nodes[:, :, None]), q[None]
    if not isinstance(reference, Reference):
        nodes = validation.float_array(name, reference)
        if nodes.shape != shape:
            raise ValueError(
                f"{name} has shape {nodes.shape}, expected {shape}: one column per node; "
                "shapes over time go in a Reference(time, nodes)"
            )
        reference = Reference([0.0], nodes[:, :, None])
    if reference.nodes.shape[:2] != shape:
        raise ValueError(
            f"reference.nodes has shape {reference.nodes.shape}, "
            f"expected {(*shape, len(reference.time))}: one column per node"
        )
    count, gamma = len(plant.commanded.strings), reference.force_density
    if gamma is not None and len(gamma) != count:
        raise ValueError(
            f"reference.force_density has shape {gamma.shape}, expected "
            f"({count}, {len(reference.time)}): one row per string"
        )
    q = _reached(plant, reference, name)
    if not anywhere:
        _refuse_motion_as_one_body(plant, reference, name)
    return reference, q


def _reached(plant: LinearPlant, reference: Reference, name: str) -> FloatArray:
    """Return q of each shape, shape (K, r), or raise where the plant cannot come to it."""
    structure, shapes = plant.model.structure, np.moveaxis(reference.nodes, 2, 0)
    names = [f"{name} at {time:g} s" for time in reference.time]
    for shape_name, N in zip(names, shapes, strict=True):
        if plant.drives_bars:
            refuse_passive_bars(plant, shape_name, N)
        else:
            refuse_wrong_bar_lengths(shape_name, structure, N, _OFF)
        refuse_moved_supports(shape_name, structure, N, _OFF)
    if plant.drives_bars:
        still = np.zeros_like(plant.nodes)
        q = np.array([plant.measure(N, still)[: plant.degrees_of_freedom] for N in shapes])
    else:
        q = np.array(
            [reduced_shape(plant, *pair, 2 * _OFF) for pair in zip(names, shapes, strict=True)]
        )
    # A mirror image keeps all lengths, but bars would have to pass through one another on the way:
    # from the operating point to the nearest shape, and from each shape to the next.
    apart = [bar_distances(structure, N) for N in (plant.nodes, *shapes)]
    touching = _TOUCHING * float(np.ptp(plant.nodes, axis=1).max())
    sides = np.array([between.side * (between.distance > touching) for between in apart])
    near = int(np.linalg.norm(q, axis=1).argmin())
    before, after = sides[:-1], np.vstack([sides[near + 1], sides[2:]])
    passed = np.argwhere(before * after < 0)
    if len(passed):
        step, pair = passed[0]
        i, j = apart[0].pairs[pair]
        raise ValueError(
            f"in {names[step or near]}, bars {i} and {j} have changed sides: they would have to "
            "pass through each other, as from a shape to its mirror image. Give intermediate "
            "shapes that lead around, if there are any"
        )
    return q


def _refuse_motion_as_one_body(plant: LinearPlant, reference: Reference, name: str) -> None:
    """Raise if no shape is asked for, but another place of a structure that nothing holds."""
    if not plant.coordinates.is_loose or plant.model.contacts is not None:
        return
    shapes = np.moveaxis(reference.nodes, 2, 0)
    laid = np.array([plant.coordinates.laid_over(N, np.zeros_like(N))[0] for N in shapes])
    size = float(np.ptp(plant.nodes, axis=1).max())
    for first, share in (((plant.nodes, plant.nodes), _MOVED), ((shapes[0], laid[0]), _TRAVELLED)):
        gone, changed = (
            np.linalg.norm(now - before, axis=1).max(axis=1)
            for now, before in zip((shapes, laid), first, strict=True)
        )
        k = int(gone.argmax())
        if gone[k] > share * size and changed.max() < _UNCHANGED * gone[k]:
            raise ValueError(
                f"{name} asks for a rigid-body motion only: at {reference.time[k]:g} s "
                f"by up to {gone[k]:.3g} m, without a change of shape. {STRINGS_MOVE_NO_CENTRE}"
            )


def reduced_shape(plant: LinearPlant, name: str, nodes: FloatArray, off: float) -> FloatArray:
    """Return q of a shape, shape (r,), or raise where the coordinates of the plant end before.

    Strings may then be ``off`` in their lengths, as a part of the size.
    """
    q = plant.measure(nodes, np.zeros_like(nodes))[: plant.degrees_of_freedom]
    lengths = bar_lengths(plant.model.structure, nodes) if plant.drives_bars else None
    try:
        reached = plant.to_nodes(q, lengths)
    except ValueError as cause:
        raise ValueError(f"{name} is out of reach of the operating point: {cause}") from cause
    length = plant.model.structure.string_length
    error = float(np.abs(length(reached) - length(nodes)).max(initial=0.0))
    if error > off * float(np.ptp(plant.nodes, axis=1).max()):
        raise ValueError(
            f"{name} is too far from the operating point for these coordinates: strings are "
            f"{error:.3g} m off; linearize about a nearer shape"
        )
    return q


def _refined(time: FloatArray, sample_time: float) -> FloatArray:
    """Return times with no gap above a sample."""
    blocks = [
        np.linspace(start, end, max(1, int(np.ceil((end - start) / sample_time))), endpoint=False)
        for start, end in pairwise(time)
    ]
    return np.concatenate([*blocks, time[-1:]])


def refuse_passive_bars(plant: LinearPlant, name: str, nodes: FloatArray) -> None:
    """Raise if a shape asks a bar that is not driven for another length."""
    structure, actuation = plant.model.structure, plant.actuation
    assert plant.rest_length is not None  # bars are driven
    length = bar_lengths(structure, nodes)
    members = member_lengths(plant, plant.rest_length, length)
    held = strings_of(actuation, inputs_of(actuation, members))
    held = held[member_rows(plant.input, plant.commanded)[1]]
    off = np.abs(length / held - 1)
    bar = int(off.argmax())
    if off[bar] > _OFF:
        raise ValueError(
            f"in {name}, bar {bar} is {length[bar]:.9g} m long, but the drives of the plant leave "
            f"it at {held[bar]:.9g} m: drive it by linearize(..., actuated=[...]), or give another "
            "shape"
        )


def _held(
    plant: LinearPlant, q: FloatArray, shapes: FloatArray, wanted: FloatArray, response: FloatArray
) -> FloatArray:
    """Return rest, input, γ nearest the wanted, tension and drift of each shape, (K, ·).

    ``q`` are the shapes, (K, d, n), in the coordinates of the plant.
    """
    structure, law = plant.model.structure, plant.model.strings
    assert law is not None  # rest lengths are the input, or held
    offset, slope = _accelerations(plant, shapes)
    chosen = to_model_strings(plant, "force_density", wanted.T)
    chosen[:, plant.slack], slope[:, :, plant.slack] = 0.0, 0.0  # what is slack stays so
    lengths = np.array([structure.string_length(N) for N in shapes])
    if plant.drives_bars or not plant.actuation.is_whole:
        bars = np.linalg.norm([structure.bar_vectors(N) for N in shapes], axis=1)
        return _held_by_some(plant, q, chosen, (lengths, bars), offset, slope, response)
    left = offset + (slope @ chosen[..., None])[..., 0]
    gamma = chosen - _ridge(slope, left)  # from the operating point
    gamma = np.clip(gamma, 0.0, _STRONGEST * law.largest_force_density)
    left = offset + (slope @ gamma[..., None])[..., 0]
    rest_length = np.array(
        [
            law.rest_length(length, densities)
            for length, densities in zip(lengths, gamma, strict=True)
        ]
    )
    if len(plant.slack):
        given = to_model_strings(plant, "rest_length", plant.string_values)
        rest_length[:, plant.slack] = given[plant.slack]
    rests = np.hstack([q, np.zeros_like(q)])
    wound = to_commanded_strings(plant, "rest_length", rest_length)
    return np.hstack([rests, wound, gamma, gamma * lengths, left @ response.T])


def _ridge(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """Return x by ridge regression of ``A x = b``, shape by shape: (K, f, m) and (K, f)."""
    U, sizes, Vt = np.linalg.svd(matrix, full_matrices=False)
    squares = sizes**2 + (_RIDGE * sizes[:, :1]) ** 2
    gain = np.divide(sizes, squares, out=np.zeros_like(sizes), where=squares > 0)
    along = gain * (U.swapaxes(1, 2) @ target[..., None])[..., 0]
    return np.asarray((Vt.swapaxes(1, 2) @ along[..., None])[..., 0])


def _held_by_some(
    plant: LinearPlant,
    q: FloatArray,
    chosen: FloatArray,
    lengths: tuple[FloatArray, FloatArray],
    offset: FloatArray,
    slope: FloatArray,
    response: FloatArray,
) -> FloatArray:
    """Return what :func:`_held` does where some strings are passive or ganged, or bars are driven.

    Driven bars have the lengths of the shapes; ``lengths`` are those of strings and bars. By Newton
    steps for the inputs of strings, as γ is not linear in rest lengths: the γ of passive strings
    follows from their rest lengths, and what is left out of balance is a drift.
    """
    law, actuation = plant.model.strings, plant.actuation
    assert law is not None  # the rest length is the input
    # The inputs nearest to the chosen γ.
    wanted = np.array(
        [
            law.rest_length(length, densities)
            for length, densities in zip(lengths[0], chosen, strict=True)
        ]
    )
    assert plant.rest_length is not None  # then, too
    wanted[:, plant.slack] = to_model_strings(plant, "rest_length", plant.rest_length)[plant.slack]
    members = member_lengths(plant, to_commanded_strings(plant, "rest_length", wanted), lengths[1])
    near = inputs_of(actuation, members.T).T
    inputs = near
    for number in range(_NEWTON):
        gamma, by_length = _force_densities(plant, lengths[0], _rest_lengths(plant, inputs))
        left = offset + (slope @ gamma[..., None])[..., 0]
        if number == _NEWTON - 1 or not plant.winds_strings:
            break
        by_input = np.array(
            [by_density * row @ input_matrix(plant, "rest_length")
             for by_density, row in zip(slope, by_length, strict=True)]
        )  # fmt: skip
        # Of the inputs that balance the shape linearized here, those nearest to the chosen.
        target = left + (by_input @ (near - inputs)[..., None])[..., 0]
        inputs = np.maximum(near - _ridge(by_input, target), _SHORTEST * near)
    rests = np.hstack([q, np.zeros_like(q)])
    return np.hstack([rests, inputs, gamma, gamma * lengths[0], left @ response.T])


def _rest_lengths(plant: LinearPlant, inputs: FloatArray) -> FloatArray:
    """Return rest lengths of the model's strings at inputs, (K, m), m, shape (K, α')."""
    if not plant.winds_strings:
        assert plant.rest_length is not None  # bars are driven, and strings keep theirs
        return np.tile(plant.rest_length, (len(inputs), 1))
    strings = member_rows(plant.input, plant.commanded)[0]
    members = plant.actuation.offset + moved_by(plant.actuation, inputs)
    return to_model_strings(plant, "rest_length", members[:, strings])


def _force_densities(
    plant: LinearPlant, lengths: FloatArray, rest_length: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return γ of strings, (K, α'), and its change with their rest lengths."""
    law = plant.model.strings
    assert law is not None  # callers have rest lengths
    step = _STEP * rest_length
    least, most, gamma = (
        np.array([law.force_density(*pair) for pair in zip(lengths, values, strict=True)])
        for values in (rest_length + step, rest_length - step, rest_length)
    )
    gamma[:, plant.slack] = 0.0
    return gamma, (least - most) / (2 * step)


def _refuse_moved_passive(plant: LinearPlant, shapes: FloatArray, gamma: FloatArray) -> None:
    """Raise if the γ of a reference ask a passive string for another rest length."""
    strings = member_rows(plant.input, plant.commanded)[0]
    passive, law = plant.actuation.passive, plant.model.strings
    passive = passive[passive < strings.stop]
    if not len(passive) or plant.commanded is not plant.model.structure:
        return
    assert law is not None  # the rest length is the input
    usual = plant.string_values[passive]
    for shape, asked in zip(shapes, gamma.T, strict=True):
        length = plant.model.structure.string_length(shape)
        off = np.abs(law.rest_length(length, asked)[passive] - usual) * (asked[passive] > 0)
        i = int(off.argmax())
        if off[i] > _PASSIVE * float(length.max()):
            raise ValueError(
                f"reference.force_density asks string {passive[i]} for a rest length "
                f"{off[i]:.2g} m off {usual[i]:.4g} m, but the string is passive: leave "
                "force_density out, or give shapes that the driven strings hold"
            )


def _accelerations(plant: LinearPlant, shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return q̈ at zero γ, shape (K, r), and its derivative by γ, (K, r, α'), at rest in shapes."""
    at_zero, derivative, project = _acceleration_at_rest(plant)
    rows = plant.model.structure.free_rows
    columns = shapes.transpose(0, 2, 1).reshape(len(shapes), -1)[:, rows].T
    offset = evaluate_columns(at_zero, np.asfortranarray(columns))[0].T @ project.T
    # One pass backward for each coordinate: few coordinates of a large structure take few.
    slope = [
        evaluate_columns(derivative, np.tile(column[:, None], len(project)), project.T)[0].T
        for column in columns.T
    ]
    return offset, np.array(slope)


@kept
def _acceleration_at_rest(plant: LinearPlant) -> tuple[ca.Function, ca.Function, FloatArray]:
    """Return ``N -> N̈`` at zero γ, ``(N, w) -> (∂N̈/∂γ)ᵀ w``, and the matrix of q̈ by N̈.

    Both are of what is free, node by node, at rest.
    """
    model, rows = plant.model, plant.model.structure.free_rows
    N, gamma = ca.SX.sym("N", len(rows)), ca.SX.sym("gamma", len(model.structure.strings))
    x, w = ca.vertcat(N, ca.DM.zeros(len(rows))), ca.SX.sym("w", len(rows))
    moved = model.dynamics(x, gamma, *map(ca.DM, plant.load_input))[len(rows) :]
    at_zero, derivative = ca.substitute(moved, gamma, 0), ca.jtimes(moved, gamma, w, True)
    return (
        Function("at_zero", [N], [ca.densify(at_zero)]),
        Function("derivative", [N, w], [ca.densify(derivative)]),
        plant.coordinates.projection[:, rows],
    )
