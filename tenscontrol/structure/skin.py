"""Elastic skins: panels of a structure covered by a mesh of strings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.structure.connectivity import refuse_many_members
from tenscontrol.structure.structure import Structure

# Corners further off the plane of their panel than this part of its size are refused. Nodes
# written down with four digits pass.
_PLANAR = 1e-4

# Lengths and areas below this fraction of the panel's are none.
_ZERO = 1e-9

Loop = tuple[int, ...]


def skin(
    structure: Structure,
    panels: str | Sequence[object],
    iterations: int = 1,
    node_mass: float | None = None,
    panel_mass: object = None,
    areal_density: object = None,
    group: str = "skin",
) -> Structure:
    """Return the structure with an elastic skin on its panels: a mesh of strings.

    Each panel gets a node at its centre, the mean of its corners, and strings from it to the
    corners. This is repeated inside each new triangle, ``iterations`` times in all. Nodes and
    strings of ``structure`` come first, in their order; the new ones follow panel by panel. The
    result has ``structure`` as its ``parent``.

    Parameters
    ----------
    structure : Structure
    panels : sequence, or one name
        Names of string groups, or loops of nodes around the panels. A string group whose strings
        form closed loops is a name: ``"top"`` and ``"bottom"`` of a prism. ``"sides"`` are the 2q
        triangles between neighbouring vertical strings of a prism. A loop has three or more node
        indices.
    iterations : int
        How often each triangle is divided, n, at least 0. With 0 the result is ``structure``.
    node_mass : float, optional
        Mass of each new node, kg.
    panel_mass : float or array_like, shape (p,), optional
        Mass of each panel, kg, instead: one number for all, or one per panel,
        each triangle of ``"sides"`` counted.
    areal_density : float or array_like, shape (p,), optional
        Mass of each panel over its area, kg/m², instead.
    group : str
        String group of the new strings.

    Returns
    -------
    Structure

    Raises
    ------
    TypeError, ValueError
        If a panel is no known name (the message lists those there are) or no loop of nodes; if a
        loop has fewer than three nodes or names one twice, lies further off a plane than 1e-4 of
        its size, crosses itself, or is so bent inwards that its centre does not see every edge; if
        two panels have the same nodes; if not exactly one mass is given, or it is not positive.

    Notes
    -----
    After Goyal & Skelton, *Dynamics of Class 1 Tensegrity Systems Including
    Cable Mass*, example 2. A panel with v corners gets, after n ≥ 1 iterations,
    ::

        nodes      1 + v + 3v + … = 1 + v (3ⁿ⁻¹ − 1)/2
        strings    v + 3v + 9v + … = v (3ⁿ − 1)/2

    A skin has strings along its edges: where an edge of a panel is neither a bar nor a string, a
    string is added, once for the panels that share it. The sides of a prism are bounded by its top,
    bottom and vertical strings and, since four nodes of a side are in no plane, by a new string
    along the diagonal that has no bar.

    The mass of a panel is spread evenly over its area. Each triangle of the final mesh gives its
    mass in equal parts to those of its corners that are new nodes: what a corner of the panel would
    carry goes to the new nodes around, so that the nodes of ``structure`` keep theirs. So the mass
    of a panel is exact, and its moments of inertia grow towards those of the sheet with n.

    One force density for all new strings pulls each new node evenly to all
    sides, so it is at rest. A skin stretched by the strain ε in the reference
    shape has ``rest_length = skinned.string_length() / (1 + ε)`` in its strings.

    Examples
    --------
    The prism of the paper's example 2:

    >>> import tenscontrol as tc
    >>> skinned = tc.skin(tc.prism(), ("top", "bottom"), iterations=2, node_mass=0.01)
    >>> skinned, len(skinned.strings_in("skin"))
    (Structure(14 nodes, 3 bars, 33 strings), 24)

    A panel given by its nodes:

    >>> tc.skin(tc.prism(), [(0, 1, 3)], panel_mass=0.05).string_node_mass
    array([0.05])
    """
    validation.instance(
        "structure", structure, Structure, "make one by Structure(...) or prism(...)"
    )
    if structure.dimension != 3:
        raise ValueError("structure is planar, nodes of shape (2, n); a skin needs one in space")
    count = validation.whole_number("iterations", iterations, 0, 500)  # 3^500 is a number yet
    validation.identifier("group", group)
    loops = _loops(structure, panels)
    is_bare = count == 0 or not loops
    masses = {"node_mass": node_mass, "panel_mass": panel_mass, "areal_density": areal_density}
    if is_bare and all(mass_given is None for mass_given in masses.values()):
        return structure
    density = _density(loops, structure.nodes, masses)
    if is_bare:
        return structure
    around = sum(map(len, loops.values()))
    refuse_many_members(f"iterations is {count}", around * (3.0**count - 1) / 2)

    known = structure.nodes.shape[1]
    places = list(structure.nodes.T)
    mass: list[float] = []
    strings: list[tuple[int, int]] = []
    joined = {frozenset(pair) for pair in [*structure.bars.tolist(), *structure.segments.tolist()]}
    for loop, per_area in zip(loops.values(), density, strict=True):
        for edge in _edges(loop):
            if frozenset(edge) not in joined:
                joined.add(frozenset(edge))
                strings.append(edge)
        polygons = [loop]
        for _ in range(count):
            triangles: list[Loop] = []
            for corners in polygons:
                centre = len(places)
                places.append(np.mean([places[i] for i in corners], axis=0))
                strings += [(corner, centre) for corner in corners]
                triangles += [(a, b, centre) for a, b in _edges(corners)]
            polygons = triangles
        mass += [0.0] * (len(places) - known - len(mass))
        for triangle, area in zip(polygons, _areas(polygons, places), strict=True):
            new = [i for i in triangle if i >= known]
            for i in new:
                mass[i - known] += per_area * area / len(new)
    if node_mass is not None:
        mass = [float(node_mass)] * len(mass)
    return Structure(
        nodes=np.column_stack(places),
        bars=structure.bars,
        strings=[*(structure.paths or structure.strings.tolist()), *strings],
        bar_mass=structure.bar_mass,
        point_mass=np.concatenate([structure.point_mass, mass]),
        string_groups=[*structure.string_groups, *[group] * len(strings)],
        fixed=structure.fixed,
        rollers=structure.rollers,
        parent=structure,
    )


def skin_rest_length(
    structure: Structure, rest_length: object, prestretch: float = 0.0
) -> FloatArray:
    """Return the rest lengths of a structure with skin: those given, and those of the skin.

    Parameters
    ----------
    structure : Structure
        Made by :func:`skin`, or one without skin.
    rest_length : float or array_like, shape (α,)
        Rest lengths of the strings of ``structure.parent``, m; without skin, of its own.
    prestretch : float
        ε: the skin strings are this part longer in the reference shape than at
        rest, ``l0 = l/(1 + ε)``. 0 is just taut; below 0 is slack, above −1.

    Returns
    -------
    ndarray, shape (α′,)
        m, in the order of the strings of ``structure``.

    Raises
    ------
    TypeError, ValueError
        If the structure was subdivided, or an argument is not finite or out of range.

    Examples
    --------
    >>> import tenscontrol as tc
    >>> skinned = tc.skin(tc.prism(), panels=["top"], iterations=1, node_mass=0.01)
    >>> tc.structure.skin_rest_length(skinned, 0.8, prestretch=0.25).round(4)
    array([0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8, 0.4, 0.4, 0.4])
    """
    validation.instance("structure", structure, Structure, "make one by skin(...)")
    if structure.string_parent is not None:
        raise ValueError(
            "structure is subdivided: give its parent, and "
            "tenscontrol.structure.spread_rest_length(...) spreads the answer over segments"
        )
    count = len((structure.parent or structure).strings)
    given = validation.per_member("rest_length", rest_length, count, "string of the parent")
    validation.positive("rest_length", given, "length in m")
    stretch = validation.float_array("prestretch", prestretch)
    if stretch.ndim or stretch <= -1:
        raise ValueError(f"prestretch is {prestretch!r}, expected a number above -1")
    return np.concatenate([given, structure.string_length()[count:] / (1 + float(stretch))])


def _edges(loop: Loop) -> list[tuple[int, int]]:
    """Return the pairs of neighbours around a loop."""
    return list(zip(loop, loop[1:] + loop[:1], strict=True))


def _areas(triangles: Sequence[Loop], places: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """Return the areas of triangles of nodes, m²; ``places`` are rows x, y, z."""
    corners = [[places[i] for i in triangle] for triangle in triangles]
    a, b, c = np.array(corners).transpose(1, 0, 2)
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def _density(loops: dict[str, Loop], nodes: FloatArray, masses: dict[str, object]) -> FloatArray:
    """Return the areal density of each panel, kg/m²; zeros where nodes have their own mass."""
    given = [name for name, value in masses.items() if value is not None]
    if len(given) != 1:
        raise ValueError(
            f"found {' and '.join(given) or 'no mass'}, expected exactly one of node_mass (kg, of "
            "each new node), panel_mass (kg, of each panel) and areal_density (kg/m²)"
        )
    name = given[0]
    if name == "node_mass":
        validation.positive_number(name, masses[name], "kg")
        return np.zeros(len(loops))
    value = validation.per_member(name, masses[name], len(loops), "panel")
    validation.positive(
        name, value, "mass in kg" if name == "panel_mass" else "areal density in kg/m²"
    )
    if name == "areal_density":
        return value
    for k, loop in enumerate(loops.values()):
        corners = nodes[:, loop].T
        centre = len(loop)
        places = np.vstack([corners, corners.mean(axis=0)])
        fan = [(a, b, centre) for a, b in _edges(tuple(range(centre)))]
        value[k] /= _areas(fan, places).sum()
    return value


# ---- which panels ----


def _loops(structure: Structure, panels: object) -> dict[str, Loop]:
    """Return the node loops of all panels, checked, by what messages call them."""
    if isinstance(panels, str):
        panels = (panels,)
    named = _named_panels(structure)
    checked: dict[str, Loop] = {}
    known: set[frozenset[int]] = set()
    entries = validation.items("panels", panels, "panel names and node loops")
    for i, entry in enumerate(entries):
        if isinstance(entry, str):
            if entry not in named:
                names = ", ".join(repr(name) for name in named) or "none"
                raise ValueError(
                    f"panels[{i}] is {entry!r}, expected a name of panels of this structure "
                    f"({names}), or a loop of node indices"
                )
            several = len(named[entry]) > 1
            loops = {
                f"panels[{i}], {entry!r}" + (f" number {k}" if several else ""): loop
                for k, loop in enumerate(named[entry])
            }
        else:
            loops = {f"panels[{i}]": _given_loop(f"panels[{i}]", entry, structure.nodes.shape[1])}
        for name, loop in loops.items():
            key = frozenset(loop)
            _refuse_bad_shape(name, loop, structure.nodes)
            if key not in known:  # else it is the same panel
                known.add(key)
                checked[name] = loop
    return checked


def _given_loop(name: str, entry: object, count: int) -> Loop:
    """Return a loop given by its nodes, or say what is wrong with it."""
    array = validation.float_array(name, entry)
    if array.ndim != 1:
        hint = "; a single loop is given as panels=[loop]" if array.ndim == 0 else ""
        raise ValueError(
            f"{name} has shape {array.shape}, expected a panel name or a sequence of node "
            f"indices{hint}"
        )
    loop = validation.indices(name, array, count, f"there are {count} nodes", "node ")
    if len(loop) < 3:
        raise ValueError(f"{name} has {len(loop)} nodes, expected at least 3 around a panel")
    corners, times = np.unique(loop, return_counts=True)
    if (times > 1).any():
        raise ValueError(
            f"{name} names node {corners[times.argmax()]} twice, expected each corner once; "
            "the loop closes by itself"
        )
    return tuple(loop.tolist())


def _named_panels(structure: Structure) -> dict[str, list[Loop]]:
    """Return the loops of each string group that is made of closed loops, and the sides."""
    named = {}
    for group in dict.fromkeys(structure.string_groups):
        loops = _closed_loops(_segments_in(structure, group))
        if loops:
            named[group] = loops
    sides = _sides(structure, named)
    if sides:
        named.setdefault("sides", sides)
    return named


def _segments_in(structure: Structure, group: str) -> IntArray:
    """Return the end nodes of the segments of the strings of a group, shape (·, 2)."""
    return structure.segments[np.isin(structure.segment_string, structure.strings_in(group))]


def _closed_loops(strings: IntArray) -> list[Loop]:
    """Return the loops that these strings form, or none if not every string is in one."""
    near: dict[int, list[int]] = {}
    for a, b in strings.tolist():
        near.setdefault(a, []).append(b)
        near.setdefault(b, []).append(a)
    if any(len(others) != 2 for others in near.values()):
        return []
    loops, left = [], dict(near)
    for start, (second, _) in near.items():
        if start in left:
            loop = [start]
            before, here = start, second
            while here != start:
                loop.append(here)
                before, here = here, next((i for i in near[here] if i != before), start)
            if len(loop) < 3:  # two strings side by side
                return []
            for node in loop:
                del left[node]
            loops.append(tuple(loop))
    return loops


def _sides(structure: Structure, named: dict[str, list[Loop]]) -> list[Loop]:
    """Return the two triangles of each side of a prism, or none for another structure."""
    rings = [named.get(name, []) for name in ("top", "bottom")]
    if any(len(ring) != 1 for ring in rings) or "vertical" not in structure.string_groups:
        return []
    (top,), (bottom,) = rings
    vertical = _segments_in(structure, "vertical").tolist()
    below = {node: other for pair in vertical for node, other in (pair, pair[::-1])}
    if set(below) != {*top, *bottom} or {below[i] for i in top} != set(bottom):
        return []
    bars = {frozenset(pair) for pair in structure.bars.tolist()}
    around = {frozenset(edge) for edge in _edges(bottom)}
    triangles: list[Loop] = []
    for a, b in _edges(top):
        if frozenset((below[a], below[b])) not in around:
            return []
        if frozenset((a, below[b])) in bars:
            triangles += [(a, b, below[a]), (b, below[b], below[a])]
        elif frozenset((b, below[a])) in bars:
            triangles += [(a, b, below[b]), (a, below[b], below[a])]
        else:
            return []
    return triangles


# ---- whether a loop is a panel ----


def _refuse_bad_shape(name: str, loop: Loop, nodes: FloatArray) -> None:
    """Raise if a loop is not flat, has no area, crosses itself, or hides an edge."""
    corners = nodes[:, loop] - nodes[:, loop].mean(axis=1, keepdims=True)
    axes, sizes, _ = np.linalg.svd(corners, full_matrices=False)
    size = 2 * float(np.linalg.norm(corners, axis=0).max())
    if sizes[1] <= _ZERO * sizes[0]:
        raise ValueError(f"{name} has no area: its nodes {list(loop)} are on a line")
    off = np.abs(axes[:, 2] @ corners)
    if off.max() > _PLANAR * size:
        raise ValueError(
            f"{name} is not flat: node {loop[int(off.argmax())]} is {off.max():.3g} m off the "
            f"plane of its nodes, expected at most {_PLANAR * size:.3g} m "
            f"({_PLANAR:g} of its size); cut it into triangles"
        )
    flat = axes[:, :2].T @ corners / size
    # A loop that its centre sees from inside all the way, once around, does not cross itself.
    after = np.roll(flat, -1, axis=1)
    fan = flat[0] * after[1] - flat[1] * after[0]
    turns = float(np.arctan2(fan, (flat * after).sum(axis=0)).sum() / (2 * np.pi))
    fan *= np.sign(turns)
    if fan.min() <= _ZERO or abs(turns) > 1.5:
        a, b = _edges(loop)[int(fan.argmin())]
        raise ValueError(
            f"{name} crosses itself or is not convex: its edge {a} to {b} is hidden from its "
            "centre, the mean of its corners, or occurs twice; give the nodes in order around "
            "the panel, and cut it into convex panels"
        )
