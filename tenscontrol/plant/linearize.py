"""Linearization of the model about a shape at rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscontrol import validation
from tenscontrol.actuation.driven_strings import (
    BAR_INPUTS,
    Actuation,
    actuation_of,
    actuation_of_bars,
    member_rows,
    side_by_side,
    through,
)
from tenscontrol.arrays import FloatArray, IntArray, frozen
from tenscontrol.dynamics.coordinates import KINDS, Coordinates, coordinates as frame_of
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.string_laws import StringLaw
from tenscontrol.dynamics.tangent import Tangent, bar_displacements, refuse_large, tangent
from tenscontrol.fields import Array, OptionalArray, converted
from tenscontrol.plant.linear_plant import (
    PLANT_INPUTS,
    LinearPlant,
    SparsePlant,
    lead_names,
    norm,
    refuse_driven_bars,
)
from tenscontrol.plant.stance import Stance, standing_model
from tenscontrol.plant.string_outputs import to_model_strings
from tenscontrol.short_repr import short_repr
from tenscontrol.statics.equilibrium_matrix import null_space
from tenscontrol.statics.prestress import Prestress
from tenscontrol.structure.bar_geometry import (
    refuse_other_bar_lengths,
    refuse_strings_without_length,
    rigid_shape,
)
from tenscontrol.structure.segments import to_segments, to_strings
from tenscontrol.structure.structure import Structure
from tenscontrol.structure.supports import is_movable, refuse_moved_supports, rigid_motions

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Unbalanced force relative to the largest string force: far above round-off,
# far below a force density that is off by any amount one would care about.
_EQUILIBRIUM_TOLERANCE = 1e-8

# Beyond this the coordinates do not close: without a load the residual is round-off.
_INVARIANCE_TOLERANCE = 1e-8

# Stiffness below these parts of what tensions give is none, and is no measure for what is left.
_NO_STIFFNESS, _ROUND_OFF = 1e-12, 1e-6

# Force densities may differ by this part of the largest from those of given rest lengths.
_LAW_TOLERANCE = 1e-6

# Coordinates up to which dense matrices are made at once.
_USUAL = 300

# Asking for the linear model of a string this close to slack is asking for a kink.
_SLACK_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """A shape at rest and its force densities, in equilibrium or not: the point of linearization.

    Parameters
    ----------
    nodes : array_like, shape (d, n)
        Node positions, m, with the bar lengths of the structure.
    force_density : array_like, shape (α,)
        γ, N/m, at least 0.
    external_force : array_like, shape (d, n), optional
        W, N.

    Raises
    ------
    TypeError, ValueError
        If an array is not finite or does not fit.

    Examples
    --------
    A prism whose force densities do not balance, linearized all the same:

    >>> import numpy as np, tenscontrol as tc
    >>> prism = tc.prism()
    >>> at = tc.OperatingPoint(prism.nodes, np.repeat([17.3205, 17.3205, 9.0], 3))
    >>> plant = tc.linearize(tc.Model(prism), at, require_equilibrium=False)
    >>> bool(abs(plant.drift).max() > 1)
    True
    """

    nodes: Array = converted()
    force_density: Array = converted()
    external_force: OptionalArray = converted(None)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        nodes = validation.float_array("nodes", self.nodes)
        if nodes.ndim != 2 or nodes.shape[0] not in (2, 3):
            raise ValueError(
                f"nodes has shape {nodes.shape}, expected (3, n), or (2, n) in the plane: one "
                "column per node"
            )
        gamma = validation.vector("force_density", self.force_density)
        if gamma.ndim != 1:
            raise ValueError(
                f"force_density has shape {gamma.shape}, expected (α,): one per string"
            )
        load = self.external_force
        if load is not None:
            load = frozen(
                validation.shaped(
                    "external_force", load, nodes.shape, "one force for each of nodes"
                )
            )
        object.__setattr__(self, "nodes", frozen(nodes))
        object.__setattr__(self, "force_density", frozen(gamma))
        object.__setattr__(self, "external_force", load)


def linearize(
    model: Model,
    at: Prestress | OperatingPoint,
    input: str = "force_density",
    coordinates: str = "internal",
    require_equilibrium: bool = True,
    rest_length: object = None,
    actuated: object = None,
    struts: object = None,
) -> LinearPlant:
    """Return the linear plant about a shape at rest, with exact derivatives.

    Parameters
    ----------
    model : Model
    at : Prestress, Stance or OperatingPoint
        The shape and its force densities. Contacts of a :class:`Stance` become supports; see the
        notes.
    input : {"force_density", "rest_length", "bar_length", "length"}
        The input: γ for force-controlled cables, the rest length for winches. The two plants have
        different modes. Or the lengths of bars that are driven, where strings keep their rest
        lengths. Or both lengths, ``"length"``: rest lengths of strings, then lengths of bars.
    coordinates : {"internal", "minimal", "nodes"}
        See :func:`coordinates`.
    require_equilibrium : bool
        Whether to refuse a shape whose forces do not balance. If not, the
        plant carries the acceleration there as ``drift``.
    rest_length : float or array_like, shape (α,), optional
        Rest lengths, m, that give the γ of the operating point. They say how slack a string with
        γ = 0 is; without them it is just not taut.
    actuated : sequence of int or str, dict, array_like or Actuation, optional
        The strings that are driven, by index or group; all if not given. Each is an input. The
        others are passive: they keep their rest lengths, or their γ where γ is the input. Strings
        that share a winch are ganged: ``{name: strings}``, one input a name, with
        ``{string: ratio}`` in place of the strings where pulleys or signs differ; or a matrix,
        shape (α, m), of the change of each string by each input, with at most one entry a row.
        With ``input="bar_length"`` the bars that are driven, by index.
    struts : sequence of int, dict, array_like or Actuation, optional
        With ``input="length"``, the bars that are driven beside the strings of ``actuated``, given
        as these are, by index; all if not given.

    Returns
    -------
    LinearPlant

    Raises
    ------
    TypeError, ValueError
        If an argument is of the wrong kind or does not fit, the shape is not
        an equilibrium (the message says by how much), the model lacks a string
        law or a load input that is needed, or with ``input="rest_length"`` or ``"length"`` a
        string is at the border of slack, where no derivative exists. A string that is slack
        beyond the border, by ``rest_length``, moves nothing: its column of B is zero. Or if a
        contact of a stance slips (more than 0.99 of its friction is used) or just touches (less
        than a thousandth of the largest normal force).

    Notes
    -----
    In coordinates with ``Tᵀ M T = I``: ``q̈ = Tᵀ M (∂N̈/∂N T q + ∂N̈/∂Ṅ T q̇ +
    ∂N̈/∂u v)``. The tangent space of the bar constraints is invariant under A,
    so that nothing is lost by the reduction; ``invariance_residual`` says so.

    About a **stance**, which :func:`equilibrium` returns for a model with ground, the nodes that
    touch are fixed at their places: ``plant.model`` has them as fixed nodes, and no ground.
    Controllers designed on it run on the model with ground, where the feet sink and creep a little.
    So z is measured relative to the feet, ``plant.feet``, after the nearest small rigid-body motion
    that aligns them with their places.
    About an :class:`OperatingPoint`, or any other ``Prestress``, the ground of the model stays what
    it is: springs at the nodes that are in it, with the damping and friction of their laws, which
    is μ F_n/v_s per unit of speed at rest. Both agree in the limit of stiff ground and a small slip
    speed. Forces along the ground that keep a stance in balance are not there at rest, so that
    shapes which need them take ``require_equilibrium=False``.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> plant
    LinearPlant(9 internal coordinates, input force_density, 9 inputs)
    >>> plant.A.shape, plant.B.shape
    ((18, 18), (18, 9))

    With motors on three strings, and on those with a motor for two:

    >>> tc.linearize(plant.model, tc.prestress(prism, force_density=10.0), actuated=[0, 1, 8])
    LinearPlant(9 internal coordinates, input force_density, 3 inputs)
    >>> groups = {"pair": {0: 1.0, 1: -1.0}, "single": [8]}
    >>> few = tc.linearize(
    ...     plant.model, tc.prestress(prism, force_density=10.0), actuated=groups)
    >>> few.input_names
    ['gamma_pair', 'gamma_single']

    With winches for the top strings, and two bars that are telescopic struts:

    >>> model = tc.Model(prism, strings=tc.LinearStrings(stiffness=300.0))
    >>> both = tc.linearize(
    ...     model, tc.prestress(prism, force_density=10.0), "length", actuated=["top"],
    ...     struts=[0, 2])
    >>> both.input_names[2:]
    ['rest_length_top[2]', 'bar_length_bar[0]', 'bar_length_bar[2]']
    """
    validation.instance("model", model, Model, "make one by Model(structure)")
    validation.choice("input", input, PLANT_INPUTS)
    if struts is not None and input != "length":
        raise ValueError(
            f"struts are driven beside strings, but input is {input!r}: give input='length', or "
            "input='bar_length' with actuated, the bars"
        )
    if input in BAR_INPUTS:
        drives = actuated, struts
        return _of_bars(model, at, coordinates, require_equilibrium, rest_length, input, drives)
    validation.choice("coordinates", coordinates, KINDS)
    validation.truth(
        "require_equilibrium", require_equilibrium, "whether to refuse unbalanced forces"
    )
    if isinstance(at, Stance) and len(at.contacts.node):
        _refuse_other_structure(model.structure, at.structure)
        standing = standing_model(model, at)
        point = OperatingPoint(at.structure.nodes, at.force_density, at.load)
        plant = linearize(
            standing, point, input, coordinates, require_equilibrium, rest_length, actuated
        )
        return _on_feet(plant, np.unique(at.contacts.node))
    nodes, gamma, load = _checked_point(model, at)
    _refuse_other_load(model, load)
    wound = None
    if model.strings is not None:
        refuse_strings_without_length("at.nodes", model.structure, nodes)
        length = model.structure.string_length(nodes)
        wound = _rest_length(model.strings, length, gamma, rest_length)
    elif input == "rest_length" or rest_length is not None:
        raise ValueError(
            "the model has no string law, so the rest length cannot be the input; build it as "
            "Model(structure, strings=LinearStrings(stiffness=...))"
        )
    held = gamma if input == "force_density" else wound
    assert held is not None  # with a law
    actuation = actuation_of(model.structure, actuated, held)
    here = tangent(model, nodes, input, held, load)
    if require_equilibrium:
        _refuse_unbalanced(here, gamma)
    if wound is not None and input == "rest_length":
        _refuse_kink(model, gamma, wound / length)
    plant = _reduced(model, input, coordinates, here, nodes, gamma, wound, load, actuation)
    if require_equilibrium and plant.invariance_residual > _INVARIANCE_TOLERANCE:
        raise ValueError(
            f"coordinates={coordinates!r} leave out motions that are coupled with the others: "
            f"{plant.invariance_residual:.1e} of the accelerations are in those. A load of "
            "constant direction gives a rotation of the structure a stiffness, and couples it "
            "with changes of shape; use coordinates='minimal'"
        )
    return plant


def _of_bars(
    model: Model, at: object, kind: str, require_equilibrium: bool, rest_length: object,
    input: str, drives: tuple[object, object],
) -> LinearPlant:  # fmt: skip
    """Return the plant whose inputs are lengths of bars, from that of held rest lengths.

    With ``J E = L̂`` and ``Tᵀ M E = 0``: ``q̈ = −Tᵀ K (T q + E v) − Tᵀ D (T q̇ + E v̇)``. ``drives``
    are ``actuated`` and ``struts`` of :func:`linearize`.
    """
    from scipy.sparse import csr_array

    if model.strings is None:
        raise ValueError(
            "the model has no string law, so that it is not known what strings do where bars grow; "
            "build it as Model(structure, strings=LinearStrings(stiffness=...))"
        )
    if kind == "nodes":
        raise ValueError("coordinates is 'nodes', in which bars are not driven; use 'minimal'")
    if isinstance(at, Stance) and len(at.contacts.node):
        raise ValueError(
            "at stands on ground, where bars are not driven: fix the feet by "
            "Structure(..., fixed=[...])"
        )
    plant = linearize(model, at, "rest_length", kind, require_equilibrium, rest_length)  # type: ignore[arg-type]
    structure = model.structure
    assert plant.rest_length is not None  # there is a law
    actuation = _of_strings_and_bars(structure, input, drives, plant.rest_length)
    strings, bars = member_rows(input, structure)
    refuse_other_bar_lengths(
        "actuated" if input == "bar_length" else "struts", structure,
        actuation.driven[actuation.driven >= bars.start] - bars.start,
    )  # fmt: skip
    here = tangent(model, plant.nodes, "rest_length", plant.rest_length, plant.external_force)
    G = actuation.matrix
    E = bar_displacements(structure, plant.nodes, here.mass) @ G[bars]
    T = plant.coordinates.sparse_basis
    assert plant.sparse is not None  # it was just made
    by_string = plant.sparse.by_input[:, strings] @ G[strings]
    by_length = csr_array(by_string - T.T @ (here.stiffness @ E))
    rate = None
    if here.damping.nnz:
        by_rate = plant.coordinates.from_sparse(-(T.T @ (here.damping @ E)))
        rate = frozen(np.vstack([np.zeros_like(by_rate), by_rate]))
    driven = replace(
        plant, input=input, sparse=replace(plant.sparse, by_input=by_length),
        actuation=actuation, input_displacements=frozen(E), rate_input=rate, A=None, B=None,
        drift=None,
    )  # fmt: skip
    for name in ("A", "B", "drift") if driven.degrees_of_freedom <= _USUAL else ():
        getattr(driven, name)
    return driven


def _of_strings_and_bars(
    structure: Structure, input: str, drives: tuple[object, object], rest_length: FloatArray
) -> Actuation:
    """Return which bars are driven, and which strings where they are, too."""
    actuated, struts = drives
    if input == "bar_length":
        return actuation_of_bars("actuated", actuated, structure.bar_length)
    strings, bars = rows = member_rows(input, structure)
    lengths = np.concatenate([rest_length, structure.bar_length])
    if isinstance(actuated, Actuation) and len(actuated.input) == bars.stop:
        if struts is not None:
            raise ValueError("struts is given, but actuated is of strings and bars: leave it out")
        return through(actuated, lengths)
    of_strings = actuation_of(structure, actuated, lengths[strings])
    of_bars = actuation_of_bars("struts", struts, lengths[bars])
    leads = of_strings.lead, bars.start + of_bars.lead
    names = [own.names or lead_names(structure, rows, lead)
             for own, lead in zip((of_strings, of_bars), leads, strict=True)]  # fmt: skip
    return side_by_side(of_strings, of_bars, (names[0], names[1]))


def in_coordinates(plant: LinearPlant, kind: str) -> LinearPlant:
    """Return the plant of the same operating point and input in other coordinates.

    Parameters
    ----------
    plant : LinearPlant
    kind : {"internal", "minimal", "nodes"}

    Returns
    -------
    LinearPlant

    Raises
    ------
    TypeError, ValueError
        If ``plant`` is not a linear plant or ``kind`` is another word.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> prism = tc.prism()
    >>> plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=10.0))
    >>> tc.plant.in_coordinates(plant, "minimal")
    LinearPlant(15 minimal coordinates, input force_density, 9 inputs)
    """
    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")

    def build() -> LinearPlant:
        gamma = to_model_strings(plant, "force_density", plant.force_density)
        rest_length = plant.rest_length
        if rest_length is not None:
            rest_length = to_model_strings(plant, "rest_length", rest_length)
        operating_point = OperatingPoint(plant.nodes, gamma, plant.external_force)
        own = plant.commanded is plant.model.structure
        other = linearize(
            plant.model, operating_point, plant.input, kind, False, rest_length,
            plant.actuation if own else None,
        )  # fmt: skip
        other = _on_feet(other, plant.feet) if len(plant.feet) else other
        return other if own else command_parents(other, plant.actuation)

    validation.choice("kind", kind, KINDS)
    return plant.prepared.get(("in_coordinates", kind), build)


def command_parents(plant: LinearPlant, actuated: object = None) -> LinearPlant:
    """Return the plant of a subdivided structure with one input for each uncut string.

    A winch winds a whole string, not its segments: γ of a string gives s times
    γ to each of its s segments, its rest length l0 gives l0/s.

    Parameters
    ----------
    plant : LinearPlant
        Of a model whose structure was made by :func:`subdivide`; one of whole strings is returned.
    actuated : sequence of int or str, dict, array_like or Actuation, optional
        The whole strings that are driven, as for :func:`linearize`.

    Returns
    -------
    LinearPlant
        With the states of ``plant`` and the inputs of the parent. Controllers
        designed on it know the strings' own vibrations, and run on that model.

    Raises
    ------
    TypeError, ValueError
        If ``plant`` is not a linear plant, its structure has a skin, the segments of a string
        differ in their force density, or ``actuated`` does not fit or was given to
        :func:`linearize`.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> massive = tc.subdivide(tc.prism(), segments=2, node_mass=0.01)
    >>> whole = tc.statics.prism_force_density(3, 17.3205)[0]
    >>> gamma = tc.structure.spread_force_density(massive, whole)
    >>> plant = tc.linearize(tc.Model(massive), tc.prestress(massive, gamma))
    >>> plant.B.shape, tc.plant.command_parents(plant).B.shape
    ((72, 18), (72, 9))
    """
    from scipy.sparse import csr_array

    validation.instance("plant", plant, LinearPlant, "make one by linearize(model, prestress)")
    refuse_driven_bars(plant, "command_parents")
    structure = plant.model.structure
    parent = structure.parent
    if parent is None or plant.commanded is parent:
        if actuated is not None:
            raise ValueError(
                "plant is one of whole strings already: give actuated to linearize, or to the "
                "first call of command_parents"
            )
        return plant
    if not plant.actuation.is_whole:
        raise ValueError(
            "actuated of linearize names segments of strings, which no winch drives: give it to "
            "command_parents, by the whole strings"
        )
    if structure.string_parent is None:
        raise ValueError(
            "the plant is not that of a subdivided structure; subdivide(structure, ...) makes one"
        )
    gamma = to_strings(structure, "force_density", plant.force_density)
    rest_length = None
    if plant.rest_length is not None:
        rest_length = to_strings(structure, "rest_length", plant.rest_length)
    given = plant.equilibrium_input
    whole = to_segments(structure, plant.input, to_strings(structure, plant.input, given))
    if not np.allclose(whole, given, rtol=1e-9):
        quantity = plant.input.replace("_", " ")
        raise ValueError(
            f"the segments of a string differ in their {quantity}, so that no {quantity} of the "
            "whole string gives the operating point. Weight makes force densities differ along a "
            "string: linearize with input='rest_length'"
        )
    values = gamma if plant.input == "force_density" else rest_length
    assert values is not None  # with a law
    actuation = actuation_of(parent, actuated, values)
    spread = csr_array(to_segments(structure, plant.input, np.eye(len(parent.strings))).T)
    spread = csr_array(spread @ actuation.matrix)
    of_parent: dict[str, Any] = {"B": frozen(plant.B @ spread)}
    if plant.sparse is not None:
        by_input = csr_array(plant.sparse.by_input @ spread)
        of_parent = {"sparse": replace(plant.sparse, by_input=by_input), "A": None, "B": None}
    return replace(
        plant,
        **of_parent,
        commanded=parent,
        force_density=frozen(gamma),
        rest_length=None if rest_length is None else frozen(rest_length),
        actuation=actuation,
    )


def _on_feet(plant: LinearPlant, feet: IntArray) -> LinearPlant:
    """Return the plant with coordinates measured relative to feet.

    What feet move as one body is taken from all nodes, and what is left of it, from the feet.
    """
    structure, d = plant.model.structure, len(plant.nodes)
    rows = (d * feet[:, None] + np.arange(d)).ravel()
    supports = np.setdiff1d(structure.fixed_rows, rows)
    fields = rigid_motions(plant.nodes)
    if len(supports):
        fields = fields @ null_space(fields[supports])
    relative = fields, np.linalg.pinv(fields[rows]), rows
    measured = replace(plant.coordinates, _feet=relative)
    return replace(plant, coordinates=measured, feet=frozen(feet), A=None, B=None, drift=None)


def _reduced(
    model: Model,
    input: str,
    kind: str,
    here: Tangent,
    nodes: FloatArray,
    gamma: FloatArray,
    rest_length: FloatArray | None,
    load: FloatArray,
    actuation: Actuation,
) -> LinearPlant:
    """Return the plant of forces and their derivatives in coordinates."""
    from scipy.sparse import csr_array

    frame, free = frame_of(model, nodes, kind), model.structure.free_rows
    if kind == "nodes":  # bars need not keep their lengths
        refuse_large("the stiffness of all nodes", (len(free), len(free)))
        bent, inputs = here.curvature[:, free].toarray(), here.by_input.toarray()
        stiffness, damping, by_input = (
            csr_array(here.accelerations(forces, turned))
            for forces, turned in (
                (here.stiffness[:, free].toarray(), bent),
                (here.damping[:, free].toarray(), 0 * bent),
                (inputs, np.zeros((len(bent), inputs.shape[1]))),
            )
        )
        drift = here.acceleration[free]
    else:
        T = frame.sparse_basis
        stiffness, damping = (
            csr_array(T.T @ matrix @ T) for matrix in (here.stiffness, here.damping)
        )
        by_input, drift = csr_array(T.T @ here.by_input), T.T @ here.force
    # Where force densities are held, shapes may meet no stiffness at all but round-off.
    held = norm(by_input) * float(np.linalg.norm(gamma)) / float(np.ptp(nodes))
    if norm(stiffness) <= _NO_STIFFNESS * held:
        stiffness = csr_array(stiffness.shape)
    if not actuation.is_whole:
        by_input = csr_array(by_input @ actuation.matrix)
    plant = LinearPlant(
        model=model,
        coordinates=frame,
        input=input,
        sparse=SparsePlant(stiffness, damping, by_input, frozen(drift)),
        commanded=model.structure,
        force_density=frozen(gamma),
        rest_length=None if rest_length is None else frozen(rest_length),
        external_force=frozen(load),
        invariance_residual=_left_out(frame, stiffness, damping, _ROUND_OFF * held),
        actuation=actuation,
    )
    if frame.count <= _USUAL:  # made now, not at the first use
        for name in ("A", "B", "drift", "basis"):
            getattr(plant, name)
        frame.project(np.zeros(nodes.size))
    return plant


def _left_out(frame: Coordinates, stiffness: csr_array, damping: csr_array, least: float) -> float:
    """Return what rigid-body motions, which internal coordinates leave out, meet and are given."""
    if frame.kind != "internal":
        return 0.0
    R, residuals = frame.rigid, [0.0]
    for matrix, size in ((stiffness, least), (damping, 0.0)):
        size = max(norm(matrix), size, 1e-300)
        # Of accelerations by changes of shape, and by the motions themselves: as loads may give.
        given = (matrix.T @ R).T
        given = given - (given @ R) @ R.T
        residuals.append(float(np.linalg.norm(given)) / size)
        residuals.append(float(np.linalg.norm(matrix @ R)) / size if matrix is stiffness else 0.0)
    return max(residuals)


def _checked_point(
    model: Model, point: Prestress | OperatingPoint
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return nodes, γ and load, checked against the structure of the model."""
    structure = model.structure
    if isinstance(point, Prestress):
        _refuse_other_structure(structure, point.structure)
        nodes: object = point.structure.nodes
    elif isinstance(point, OperatingPoint):
        nodes = point.nodes
    else:
        raise TypeError(
            f"at is a {type(point).__name__}, expected the result of prestress(...), "
            "or an OperatingPoint(nodes, force_density)"
        )
    N = structure.checked_nodes("at.nodes", nodes)
    refuse_moved_supports("at.nodes", structure, N)
    N = rigid_shape("at.nodes", structure, N)
    count = len(structure.strings)
    gamma = validation.shaped("at.force_density", point.force_density, (count,), "one per string")
    validation.non_negative("at.force_density", gamma, "a string can only pull")
    load = np.zeros(N.shape)
    if point.external_force is not None:
        load = validation.shaped(
            "at.external_force", point.external_force, N.shape, "one force per node"
        )
    return N, gamma, load


def _refuse_other_structure(ours: Structure, theirs: Structure) -> None:
    names = ("bars", "strings", "segments", "bar_mass", "string_node_mass", "point_mass", "fixed",
             "fixed_rows")  # fmt: skip
    for name in names:
        if not np.array_equal(getattr(ours, name), getattr(theirs, name)):
            raise ValueError(
                f"the prestress and the model differ in their {name}; "
                "compute the prestress of the structure that the model was built for"
            )


def _refuse_unbalanced(here: Tangent, gamma: FloatArray) -> None:
    structure = here.structure
    d = structure.dimension
    # What a roller holds is in balance.
    left = np.zeros(here.force.size)
    left[structure.free_rows] = (here.mass @ here.acceleration)[structure.free_rows]
    unbalanced = np.linalg.norm(left.reshape(-1, d), axis=1)
    scale = max(
        float((gamma * here.string_length).max(initial=0.0)), float(np.abs(here.load).max())
    )
    if unbalanced.max() > _EQUILIBRIUM_TOLERANCE * scale:
        worst = int(unbalanced.argmax())
        raise ValueError(
            f"not an equilibrium: node {worst} is left with an unbalanced force of "
            f"{unbalanced[worst]:.3g} N, expected less than "
            f"{_EQUILIBRIUM_TOLERANCE * scale:.1e} N. Start from prestress(...), or pass "
            "require_equilibrium=False to get a plant with a drift"
        )


def _refuse_other_load(model: Model, load: FloatArray) -> None:
    """Refuse a load that the model neither has built in nor takes as an input."""
    if model.has_external_force:
        return
    free = model.structure.free
    off = np.abs(load - model.constant_force)[:, free]
    if off.size and off.max() > 1e-9 * max(float(np.abs(load).max()), 1e-300):
        node = int(free[off.max(axis=0).argmax()])
        raise ValueError(
            f"the operating point carries another load than the model: at node {node} "
            f"{load[:, node]} N against {model.constant_force[:, node]} N. Build the model with "
            "this load, Model(structure, external_force=..., gravity=...), or find the prestress "
            "under external_force=model.constant_force"
        )


def _rest_length(
    law: StringLaw, length: FloatArray, gamma: FloatArray, given: object
) -> FloatArray:
    """Return the rest lengths at an operating point, those of slack strings as they are given."""
    taut = law.rest_length(length, gamma)
    if given is None:
        return taut
    known = validation.per_member("rest_length", given, len(gamma), "string")
    validation.positive("rest_length", known, "length in m")
    off = np.abs(law.force_density(length, known) - gamma)
    if off.size and off.max() > _LAW_TOLERANCE * gamma.max(initial=0.0):
        i = int(off.argmax())
        raise ValueError(
            f"rest_length[{i}] is {known[i]:g} m, at which string {i} of {length[i]:g} m has "
            f"another force density than the {gamma[i]:g} N/m of the operating point; expected "
            f"{taut[i]:g} m" + ("" if gamma[i] else " or more")
        )
    return np.where(gamma > 0, taut, known)


def _refuse_kink(model: Model, gamma: FloatArray, share: FloatArray) -> None:
    """Raise if a string is at the border of slack; ``share`` are rest lengths by lengths."""
    structure = model.structure
    moving = np.zeros(len(gamma), bool)
    moving[structure.segment_string[is_movable(structure, structure.segments)]] = True
    loose = gamma <= _SLACK_TOLERANCE * gamma.max(initial=0.0)
    slack = np.flatnonzero(moving & loose & (share < 1 + _SLACK_TOLERANCE))
    if len(slack):
        raise ValueError(
            f"string {slack[0]} has γ = {gamma[slack[0]]:g} N/m, at the border between taut and "
            "slack, where its force has no derivative by the rest length. Give it some "
            "prestress, give rest_length=... if it is slack, or use input='force_density'"
        )
