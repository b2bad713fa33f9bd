"""Deflections of a structure at rest under loads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.tangent import laid_along_supports, momenta, tangent
from tenscontrol.plant.equilibrium import equilibrium
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.linearize import linearize
from tenscontrol.plant.saddle import least_curvature, least_step
from tenscontrol.plant.stance import Stance
from tenscontrol.statics.equilibrium_matrix import sparse_equilibrium_matrix
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.blocks import bar_rows, node_mass
from tenscontrol.structure.supports import (
    left_by_supports,
    refuse_load_without_support,
    rigid_motions,
    rotation_between,
)
from tenscontrol.tables import aligned
from tenscontrol.warn import warn

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array

# A part of a load above this, which no stiffness takes, is not round-off.
_NOTHING_TAKES = 1e-9

# Displacements below this part of those by the largest stiffness are none.
_RIGID = 1e-12

# Steps that refine displacements along motions that are soft beside others.
_REFINEMENTS = 5

# A shape has come back if nodes are this near, parts of its size.
_BACK = 1e-6

# Angle by which a structure without supports may turn in line with its load, rad.
_TURNED = 0.5


@dataclass(frozen=True, eq=False, repr=False)
class Deflections:
    """Displacements and forces of a structure under each of several loads. Made by `deflections`.

    Attributes
    ----------
    rest : Prestress
        The structure without these loads.
    loads : ndarray, shape (d, n, k)
        The loads, beside what acts at rest, N.
    displacement : ndarray, shape (d, n, k)
        Of the nodes from rest, m.
    linear : ndarray, shape (d, n, k)
        The same by the stiffness at rest, m; on ground, with the contacts as supports.
    string_force : ndarray, shape (α, k)
        Tension of each string under each load, N.
    bar_force : ndarray, shape (β, k)
        Force of each bar, N, positive in compression; of a body with redundant bars the least that
        balance, which are not unique.
    reaction : ndarray, shape (d, n, k)
        Forces of the supports on the nodes, N; zero where a node is free.
    slack : tuple of tuple of int
        For each load, the strings that pull at rest and no longer do.
    is_elastic : ndarray of bool, shape (k,)
        Whether the structure comes back to its rest when the load is gone.
    """

    rest: Prestress
    loads: FloatArray
    displacement: FloatArray
    linear: FloatArray
    string_force: FloatArray
    bar_force: FloatArray
    reaction: FloatArray
    slack: tuple[tuple[int, ...], ...]
    is_elastic: np.ndarray

    @property
    def largest(self) -> FloatArray:
        """Largest displacement of a node under each load, m, shape (k,)."""
        return np.asarray(np.linalg.norm(self.displacement, axis=0).max(axis=0))

    @property
    def nonlinearity(self) -> FloatArray:
        """How far the linear displacements are off, as part of the largest, shape (k,)."""
        off = np.linalg.norm(self.displacement - self.linear, axis=0).max(axis=0)
        return np.asarray(off / np.where(self.largest > 0, self.largest, 1.0))

    def table(self) -> str:
        """Return the loads as text, with what they move and the largest forces."""
        rows = []
        for k in range(self.loads.shape[2]):
            moved = np.linalg.norm(self.displacement[:, :, k], axis=0)
            node = int(moved.argmax())
            linear = np.linalg.norm(self.linear[:, node, k])
            rows.append([
                str(k), f"{np.linalg.norm(self.loads[:, :, k], axis=0).max():.4g}", str(node),
                f"{moved[node]:.4g}", f"{linear:.4g}", _largest(self.string_force[:, k]),
                _largest(self.bar_force[:, k]), " ".join(map(str, self.slack[k])) or "-",
            ])  # fmt: skip
        head = ["load", "largest N", "node", "moves m", "linear m", "string N", "bar N", "slack"]
        return aligned(head, rows)

    def force_table(self) -> str:
        """Return the forces of all members as text, N, at rest and under each load."""
        structure = self.rest.structure
        at_rest = np.concatenate([
            self.rest.force_density * structure.string_length(),
            self.rest.bar_force_density * structure.bar_length,
        ])  # fmt: skip
        forces = np.column_stack([at_rest, np.vstack([self.string_force, self.bar_force])])
        alpha = len(self.string_force)
        rows = [
            [f"string {i}" if i < alpha else f"bar {i - alpha}", *(f"{f:.4g}" for f in row)]
            for i, row in enumerate(forces)
        ]
        head = ["member", "rest N", *(f"load {k}" for k in range(self.loads.shape[2]))]
        return aligned(head, rows)

    def __repr__(self) -> str:
        count = self.loads.shape[2]
        if not count:
            return "Deflections(no loads)"
        return f"Deflections({count} loads, {self.largest.max():.4g} m at most)"


@dataclass(frozen=True, eq=False, repr=False)
class DirectionalStiffness:
    """Stiffness of a structure at rest along given directions. Made by :func:`stiffness_along`.

    Attributes
    ----------
    directions : ndarray, shape (d, n, k)
        The forces per unit: the largest on a node has length 1.
    stiffness : ndarray, shape (k,)
        Force over the displacement along it, N/m; infinite where bars alone resist.
    displacement : ndarray, shape (d, n, k)
        Of the nodes by a unit of force, m/N.
    """

    directions: FloatArray
    stiffness: FloatArray
    displacement: FloatArray

    def table(self) -> str:
        """Return the directions as text, with their stiffness and what moves most."""
        rows = []
        for k, stiffness in enumerate(self.stiffness):
            size = np.linalg.norm(self.displacement[:, :, k], axis=0)
            node = int(size.argmax())
            rows.append([str(k), f"{stiffness:.5g}", str(node), f"{size[node]:.4g}"])
        return aligned(["direction", "stiffness N/m", "node", "moves m/N"], rows)

    def __repr__(self) -> str:
        if not len(self.stiffness):
            return "DirectionalStiffness(no directions)"
        least, most = self.stiffness.min(), self.stiffness.max()
        return f"DirectionalStiffness({len(self.stiffness)}, {least:.4g} to {most:.4g} N/m)"


def deflections(
    model: Model, at: Prestress, loads: Sequence[object], *, rest_length: object = None
) -> Deflections:
    """Return displacements and member forces of a structure at rest under each of several loads.

    Bars are rigid, strings follow their law at the rest lengths that they have at rest.

    Parameters
    ----------
    model : Model
        With a string law. Its weights act too.
    at : Prestress
        The structure at rest, with a stable shape: made by :func:`prestress` or
        :func:`equilibrium`; about a :class:`~tenscontrol.plant.Stance`, on its ground.
    loads : sequence of array_like, shape (d, n)
        Forces on the nodes, N, each beside what acts at rest.
    rest_length : float or array_like, shape (α,), optional
        Rest lengths, m, that give the forces at rest: needed where strings are slack.

    Returns
    -------
    Deflections

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit; the shape at rest is unstable; nothing
        holds a load: it pushes on a mechanism, or as a whole on a structure without supports (the
        message names the node); or there is no equilibrium under a load, or it turns the structure
        over.

    Warns
    -----
    UserWarning
        If a structure does not come back when its load is gone, as after it has snapped through.

    Notes
    -----
    Shapes under load are those of :func:`equilibrium` from the shape at rest; ``linear`` ones solve
    ``K δ − Jᵀ μ = w``, ``J δ = 0`` with the stiffness K at rest, material and geometric, and the
    derivatives J of the bar lengths. Displacements of a structure without supports have no part as
    one body. To press on it, hold it by supports that bear nothing (three nodes, by `fixed` and
    `rollers`): loads keep their directions, so that it turns over otherwise.

    Examples
    --------
    A prism on three supports, pulled sideways at one of its upper nodes:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> held = tc.Structure(prism.nodes, prism.bars, prism.strings, 1.0, fixed=[3, 4, 5])
    >>> model = tc.Model(held, strings=tc.LinearStrings(stiffness=2e4))
    >>> rest = tc.prestress(held, force_density=100.0)
    >>> pull = np.zeros((3, 6))
    >>> pull[0, 0] = 10.0
    >>> found = tc.deflections(model, rest, [pull, 10 * pull])
    >>> print(found.table())
    load  largest N  node   moves m  linear m  string N      bar N  slack
    0            10     2  0.004317  0.004415   136 (8)  183.2 (2)      -
    1           100     2   0.03427   0.04415   191 (8)  258.1 (2)      -
    """
    given, plant = _loads("loads", loads, model), _plant(model, at, rest_length)
    linear = _LinearResponse.about(plant).displacements("loads", given)
    acting = at.load if isinstance(at, Stance) else at.external_force
    acting = acting - (model.constant_force - model.built_in_load)  # weights are the model's
    still = model.replace(external_force=acting)
    structure, count = at.structure, given.shape[2]
    moved, reaction, is_elastic = np.zeros(given.shape), np.zeros(given.shape), np.ones(count, bool)
    pull = np.zeros((len(structure.strings), count))
    push = np.zeros((len(structure.bars), count))
    for k in range(count):
        name = f"loads[{k}]"
        loaded = model.replace(external_force=acting + given[:, :, k])
        state = _equilibrium(name, loaded, plant, plant.nodes)
        moved[:, :, k] = _moved(name, plant, state)
        pull[:, k] = state.force_density * state.structure.string_length()
        push[:, k] = state.bar_force_density * structure.bar_length
        reaction[:, :, k] = _reaction(state)
        back = _moved(name, plant, _equilibrium(name, still, plant, state.structure.nodes))
        is_elastic[k] = np.abs(back).max() <= _BACK * np.ptp(plant.nodes, axis=1).max()
    _warn_of_snap(is_elastic)
    loosened = (at.force_density > 0)[:, None] & (pull == 0)
    slack = tuple(tuple(np.flatnonzero(column).tolist()) for column in loosened.T)
    return Deflections(
        at, frozen(given), frozen(moved), frozen(linear), frozen(pull), frozen(push),
        frozen(reaction), slack, frozen(is_elastic),
    )  # fmt: skip


def stiffness_along(
    model: Model, at: Prestress, directions: Sequence[object], *, rest_length: object = None
) -> DirectionalStiffness:
    """Return the stiffness of a structure at rest along given directions.

    Parameters
    ----------
    model : Model
        With a string law.
    at : Prestress
        The structure at rest: made by :func:`prestress` or :func:`equilibrium`. Contacts of a
        :class:`~tenscontrol.plant.Stance` are taken as supports.
    directions : sequence of array_like, shape (d, n)
        Forces on the nodes of any size: only their ratios count. One node has a force for its
        stiffness along it; two have opposite ones for that of their distance.
    rest_length : float or array_like, shape (α,), optional
        As in :func:`deflections`.

    Returns
    -------
    DirectionalStiffness

    Raises
    ------
    TypeError, ValueError
        As :func:`deflections`, or if a direction has no force.

    Notes
    -----
    With the displacements δ by forces p of which the largest is 1 N, the stiffness is
    ``1/(pᵀ δ)``: for opposite forces on two nodes, force over the change of their distance.

    Examples
    --------
    How stiff a prism is against a squeeze of its top on its bottom:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=2e4))
    >>> squeeze = np.zeros((3, 6))
    >>> squeeze[2] = [-1, -1, -1, 1, 1, 1]
    >>> for level in (100.0, 200.0):
    ...     rest = tc.prestress(prism, force_density=level)
    ...     print(tc.stiffness_along(model, rest, [squeeze]).stiffness.round(1))
    [1460.6]
    [2684.5]
    """
    given, plant = _loads("directions", directions, model), _plant(model, at, rest_length)
    for k in range(given.shape[2]):
        largest = np.linalg.norm(given[:, :, k], axis=0).max()
        if not largest > 0:
            raise ValueError(f"directions[{k}] is zero, expected a force on some node")
        given[:, :, k] /= largest
    response = _LinearResponse.about(plant)
    moved = response.displacements("directions", given)
    along = (given * moved).sum(axis=(0, 1))
    along[along < _RIGID / response.unit] = 0.0
    with np.errstate(divide="ignore"):
        stiffness = 1 / along
    return DirectionalStiffness(frozen(given), frozen(stiffness), frozen(moved))


def _loads(name: str, value: object, model: object) -> FloatArray:
    """Return checked loads, shape (d, n, k)."""
    validation.instance("model", model, Model, "make one by Model(structure, strings=...)")
    assert isinstance(model, Model)  # just checked
    shape = model.structure.nodes.shape
    loads = validation.items(name, value, "loads, one array of shape (d, n) each")
    given = np.zeros((*shape, len(loads)))
    for k, load in enumerate(loads):
        given[:, :, k] = validation.node_forces(f"{name}[{k}]", load, shape)
    return given


def _plant(model: Model, at: object, rest_length: object) -> LinearPlant:
    validation.instance("at", at, Prestress, "make one by prestress(...) or equilibrium(...)")
    assert isinstance(at, Prestress)  # just checked
    return linearize(model, at, "rest_length", "minimal", rest_length=rest_length)


@dataclass(frozen=True, eq=False)
class _LinearResponse:
    """Displacements by loads to first order about the rest of a plant."""

    plant: LinearPlant
    stiffness: csc_array  # (f, f), N/m
    rows: csr_array  # (c, f), J of the kept bars, each of length 1

    @classmethod
    def about(cls, plant: LinearPlant) -> _LinearResponse:
        """Return the response of a plant about a stable shape, or refuse it."""
        from scipy.sparse import diags_array

        model, structure, nodes = plant.model, plant.model.structure, plant.nodes
        here = tangent(model, nodes, plant.input, plant.rest_length, plant.external_force)
        free = structure.free_rows
        K = here.stiffness[free][:, free].tocsc()
        J = bar_rows(structure, structure.kept_bars, nodes)[:, free]
        J = (diags_array(1 / np.sqrt(J.multiply(J).sum(axis=1))) @ J).tocsr()
        if len(free):
            least, direction = least_curvature(K, J, 0.0)
            if least < 0:
                node = int(free[np.abs(direction).argmax()]) // structure.dimension
                raise ValueError(
                    f"at is unstable with these strings: a motion, most of node {node}, has a "
                    f"stiffness of {least:.3g} N/m. Give stiffer strings, or start from "
                    "equilibrium(model, rest_length=...), which finds a stable shape"
                )
        return cls(plant, K, J)

    @property
    def unit(self) -> float:
        """The largest stiffness, N/m."""
        return float(abs(self.stiffness).max()) or 1.0

    def displacements(self, name: str, loads: FloatArray) -> FloatArray:
        """Return the displacements by loads, shape (d, n, k), m, or refuse what nothing takes."""
        from scipy.sparse import block_array

        structure = self.plant.model.structure
        free, bars = structure.free_rows, self.rows.shape[0]
        for k in range(loads.shape[2]):
            try:
                refuse_load_without_support(structure, loads[:, :, k])
            except ValueError as error:
                raise ValueError(f"{name}[{k}]: {error}") from None
        right = loads.reshape(structure.nodes.size, loads.shape[2], order="F")[free]
        unit = self.unit
        system = block_array(
            [[self.stiffness / unit, self.rows.T], [self.rows, None]], format="csc"
        )
        off = np.vstack([right / unit, np.zeros((bars, right.shape[1]))])
        step = least_step(system, off, len(free), _REFINEMENTS)
        self._refuse_untaken(name, right, unit * (off - system @ step)[: len(free)])
        moved = np.zeros((structure.nodes.size, loads.shape[2]))
        moved[free] = step[: len(free)]
        if not _floats(self.plant):
            return moved.reshape(loads.shape, order="F")
        fields = left_by_supports(structure, rigid_motions(self.plant.nodes))
        own = momenta(node_mass(structure), fields).T
        moved -= fields @ np.linalg.solve(own @ fields, own @ moved)
        return moved.reshape(loads.shape, order="F")

    def _refuse_untaken(self, name: str, loads: FloatArray, left: FloatArray) -> None:
        """Raise if a part of a load, shape (f, k), is left that no stiffness takes."""
        largest = np.abs(loads).max(axis=0, initial=0.0)
        untaken = np.abs(left).max(axis=0, initial=0.0) > _NOTHING_TAKES * largest
        if untaken.any():
            k = int(untaken.argmax())
            row = int(self.plant.model.structure.free_rows[np.abs(left[:, k]).argmax()])
            node, axis = divmod(row, self.plant.model.structure.dimension)
            size = np.abs(left[:, k]).max()
            raise ValueError(
                f"{name}[{k}] pushes on a mechanism: {size:.3g} N on node {node} "
                f"along {'xyz'[axis]} meet no stiffness. Give strings a prestress, which stiffens "
                "mechanisms, more members or supports"
            )


def _floats(plant: LinearPlant) -> bool:
    """Return whether nothing holds a structure as one body, neither supports nor its load."""
    structure = plant.model.structure
    if plant.external_force.any() or plant.model.contacts is not None:
        return False
    return bool(left_by_supports(structure, rigid_motions(plant.nodes)).size)


def _equilibrium(name: str, model: Model, plant: LinearPlant, start: FloatArray) -> Prestress:
    """Return the equilibrium at the rest lengths of a plant, or raise and name its load."""
    try:
        return equilibrium(model, rest_length=plant.rest_length, nodes=start)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def _moved(name: str, plant: LinearPlant, state: Prestress) -> FloatArray:
    """Return displacements from rest, m, shape (d, n); without those as one body if it floats."""
    nodes = state.structure.nodes
    if not _floats(plant) or isinstance(state, Stance):
        return np.asarray(nodes - plant.nodes)
    angle = _turned(plant.nodes, nodes)
    if angle > _TURNED:
        raise ValueError(
            f"{name} turns the structure, which nothing holds, by {np.degrees(angle):.0f}° in line "
            "with it: loads keep their directions. Hold it by supports that bear nothing, such as "
            "one node fixed, one on two rollers and one on one"
        )
    mass = node_mass(state.structure)
    return laid_along_supports(state.structure, plant.nodes, mass, nodes)[0] - plant.nodes


def _turned(before: FloatArray, after: FloatArray) -> float:
    """Return the angle by which a shape has turned, rad, of the rotation that fits best."""
    trace = float(np.trace(rotation_between(before, after)))
    return float(np.arccos(np.clip(trace / 2 if len(before) == 2 else (trace - 1) / 2, -1.0, 1.0)))


def _reaction(state: Prestress) -> FloatArray:
    """Return the forces of the supports on the nodes, N, shape (d, n)."""
    structure = state.structure
    densities = np.concatenate([state.force_density, state.bar_force_density])
    members = sparse_equilibrium_matrix(structure, structure.nodes) @ densities
    reaction = np.zeros(structure.nodes.size)
    held = structure.fixed_rows
    reaction[held] = (members - state.external_force.ravel(order="F"))[held]
    return reaction.reshape(structure.nodes.shape, order="F")


def _warn_of_snap(is_elastic: np.ndarray) -> None:
    if not is_elastic.all():
        k = int(np.argmin(is_elastic))
        warn(
            f"under loads[{k}] the structure goes to another shape, from which it does not come "
            "back when the load is gone",
            UserWarning,
        )


def _largest(forces: FloatArray) -> str:
    """Return the force of the largest size and its member."""
    if not len(forces):
        return "-"
    i = int(np.abs(forces).argmax())
    return f"{forces[i]:.4g} ({i})"
