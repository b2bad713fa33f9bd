"""The motion on which integration methods are compared: model, start, inputs."""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from tenscontrol.dynamics import Equation, Model, builds, pack_state
from tenscontrol.integrate import is_expandable
from tenscontrol.plant import given_load, held_value
from tenscontrol.simulation import Scene, checked_load, initial_state
from tenscontrol.structure import Structure, free_coordinates, restore_bar_lengths
from tenscontrol.validation import (
    FloatArray,
    choice,
    frozen,
    instance,
    positive_number,
    text,
    truth,
)


@dataclass(frozen=True, eq=False)
class Case:
    """A motion in open loop, on which integration methods are compared.

    ``dataclasses.replace(case, duration=0.1)`` gives the case with another duration.

    Parameters
    ----------
    model : Model
    duration : float
        s.
    nodes, velocities : array_like, shape (d, n), optional
        Motion at the start, m and m/s; the reference shape at rest if not given.
        Bars must have their lengths, and must not be stretching.
    input : {"rest_length", "force_density"}
        What the actuators hold.
    value : float or array_like, shape (α,)
        What they hold it at: rest lengths, m, or γ, N/m.
    external_force : array_like, shape (d, n), optional
        Constant load W, N, for a model built with ``external_force=True``.
    name : str
        For titles.
    note : str
        What a reader of the result must know of how the case came about.

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, with its name.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    >>> gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    >>> start = tc.to_rest_length(model, prism.nodes, gamma).rest_length
    >>> tc.Case(model, 5.0, input="rest_length", value=start)
    Case(5 s, rest_length held, 6 nodes)
    """

    model: Model
    duration: float
    nodes: FloatArray = None  # type: ignore[assignment]  # filled below
    velocities: FloatArray = None  # type: ignore[assignment]  # filled below
    input: str = field(kw_only=True)
    value: FloatArray = field(kw_only=True)
    external_force: FloatArray | None = None
    name: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        instance("model", self.model, Model, "make one by Model(structure)")
        choice("input", self.input, ("rest_length", "force_density"))
        if self.input == "rest_length" and self.model.strings is None:
            raise ValueError(
                "input is 'rest_length', which needs a model with a string law; build it as "
                "Model(structure, strings=LinearStrings(stiffness=...))"
            )
        if self.value is None:
            raise TypeError("value is None, expected rest lengths, m, or force densities, N/m")
        text("name", self.name, "for titles")
        text("note", self.note, "what a reader of the result must know")
        given = (self.value, None) if self.input == "rest_length" else (None, self.value)
        checked_load(self.model, self.external_force)
        value = held_value(self.model, *given)
        initial_state(self.model, self.nodes, self.velocities, self.input, value)
        structure = self.model.structure
        put = object.__setattr__
        put(self, "duration", positive_number("duration", self.duration, "s"))
        put(self, "nodes", frozen(_array(self.nodes, structure.nodes)))
        put(self, "velocities", frozen(_array(self.velocities, 0 * structure.nodes)))
        put(self, "value", frozen(value))
        if self.external_force is not None:
            put(self, "external_force", frozen(given_load(self.model, self.external_force)))

    @property
    def structure(self) -> Structure:
        """The structure of the model."""
        return self.model.structure

    @property
    def size(self) -> float:
        """Largest extent of the structure at the start along an axis, m."""
        return float(np.ptp(self.nodes, axis=1).max())

    @property
    def load(self) -> FloatArray:
        """Weights and external loads on the nodes, N, shape (d, n)."""
        return checked_load(self.model, self.external_force)

    @property
    def state(self) -> FloatArray:
        """The start as integrators take it: x of the free nodes."""
        return initial_state(self.model, self.nodes, self.velocities, self.input, self.value)[0]

    def equation(self, derivatives: bool = False) -> Equation:
        """Return the state equation under the loads of the case.

        Parameters
        ----------
        derivatives : bool
            Whether a form with derivatives is needed, which compiled loops are not.
        """
        truth("derivatives", derivatives, "whether derivatives are needed")
        load = self.load - self.model.constant_force
        found = self.model.equation(self.input, load)
        if derivatives and found.form == "loops":
            return self.model.equation(self.input, load, form="mapped")
        return found

    def __repr__(self) -> str:
        title = f"{self.name}, " if self.name else ""
        nodes = self.structure.nodes.shape[1]
        return f"Case({title}{self.duration:g} s, {self.input} held, {nodes} nodes)"


def _array(value: object, default: FloatArray) -> FloatArray:
    """Return what was checked before as an array of floats, or the default."""
    return np.asarray(default if value is None else value, dtype=float)


def as_case(scene: object) -> Case:
    """Return a case as it is, or that of a scene.

    Of a scene with a controller, the open loop is taken: its actuators hold what they hold at the
    start. Nothing breaks. The note of the case says so.
    """
    if isinstance(scene, Case):
        return scene
    instance("scene", scene, Scene, "make one by load_scene(file), or give a Case")
    assert isinstance(scene, Scene)  # checked just now
    scene = scene.open_loop()
    assert scene.input is not None  # found when it was made
    return Case(
        model=scene.model,
        duration=scene.duration,
        nodes=scene.nodes,
        velocities=scene.velocities,
        input=scene.input,
        value=scene.input_value,
        external_force=scene.external_force,
        name=scene.name,
        note=scene.note,
    )


def only_free(structure: Structure, moves: FloatArray) -> FloatArray:
    """Return moves of nodes, shape (d, n), with zeros where supports hold."""
    free = np.zeros(moves.size)
    free[structure.free_rows] = free_coordinates(structure, moves)
    return free.reshape(moves.shape, order="F")


def state_change(case: Case, moves: FloatArray) -> FloatArray:
    """Return the change of the state where nodes are moved, m, shape (d, n), and no bar stretches.

    Both shapes are restored: a bar off by round-off does not count as perturbed.
    """
    moved = restore_bar_lengths(case.structure, case.nodes + moves)
    change = moved - restore_bar_lengths(case.structure, case.nodes)
    return pack_state(case.structure, change, np.zeros_like(change))


# States up to which all eigenvalues are found; of more, only the six largest.
_DENSE = 600


@builds
def fastest_rate(case: Case) -> float:
    """Return the largest magnitude of the eigenvalues of ∂f/∂x at the start, 1/s.

    All strings pull. Of an undamped structure that is its highest angular frequency ω; with ground
    that with all nodes on it, too; 1/duration at least.
    """
    equation = case.equation(derivatives=True)
    x, u, taut, _ = equation.symbols(ca.SX if is_expandable(equation) else ca.MX)
    jacobian = ca.Function("jacobian", [x, u, taut], [ca.jacobian(equation.slope(x, u, taut), x)])
    pulls, rates = np.ones(equation.switches), [1 / case.duration]
    if equation.contacts is not None:
        # Of nodes that stand still, however far above the ground: damping would say more there.
        n = equation.states // 2
        still = np.concatenate([case.state[:n], np.zeros(n)])
        stiffness = jacobian(still, case.value, pulls)[n:, :n]
        rates.append(float(np.sqrt(_largest_eigenvalue(stiffness))))
        contacts = slice(equation.switches - equation.contacts.switches, None)
        depth = equation.gap(case.state, case.value)[0].full()[contacts, 0]
        pulls[contacts] = depth > 0
    return max(_largest_eigenvalue(jacobian(case.state, case.value, pulls)), *rates)


def _largest_eigenvalue(matrix: ca.DM) -> float:
    """Return the largest magnitude of the eigenvalues of a square matrix."""
    if matrix.shape[0] <= _DENSE:
        found = np.linalg.eigvals(matrix.full())
    else:
        from scipy.sparse.linalg import eigs

        found = eigs(matrix.sparse().tocsc(), k=6, which="LM", return_eigenvectors=False)
    return float(np.abs(found).max(initial=0.0))
