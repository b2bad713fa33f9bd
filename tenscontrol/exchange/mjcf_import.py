"""MJCF, the model format of MuJoCo, read: bars on bodies, strings from spatial tendons."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import product
from xml.etree.ElementTree import Element

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.string_laws import ElasticStrings, LinearStrings, StringLaw
from tenscontrol.exchange.imported import Imported
from tenscontrol.exchange.mjcf_document import MjcfDocument, Placed, number, numbers, row
from tenscontrol.structure.structure import Structure

# Places that are closer, as part of the size, are one.
_SAME = 1e-9

# Of a number at the end of a name.
_DIGITS = 18

# Attributes of tendons that strings do not have.
_LOST = ("frictionloss", "armature", "range")


def from_mujoco(source: object, tolerance: float = 1e-6) -> Imported:
    """Return the model of an MJCF file or text: bars, strings, and how they are joined.

    A capsule or cylinder is a bar; a spatial tendon over sites is a string. Bodies may be nested:
    ball joints and ``connect`` constraints join bars (hinges about y in the plane of x and z), what
    is part of the world is fixed, a slide that is missing is a roller. Masses at the ends of a bar,
    and bodies without a bar, are point masses. Stiffness is that of the tendon, or of an actuator
    that makes a spring of it. Defaults and their classes are followed.

    Parameters
    ----------
    source : str or path
        The path of a file, or the text itself, which begins with ``<``.
    tolerance : float
        How far a site or joint may be from the end of its bar, as part of its length. It is put
        there.

    Returns
    -------
    Imported

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not MJCF, or has what a tensegrity structure has not: it is named.

    Notes
    -----
    Nodes, bars and strings are in the order of the numbers that their names end in, if all have
    one, else as they come. A bar's inertia becomes that of a thin one. Contacts, motions at the
    start and actuators that are no springs are left out; ``notes`` says so.

    Examples
    --------
    >>> import numpy as np, tenscontrol as tc
    >>> ball = tc.library.six_bar_ball()
    >>> model = tc.Model(ball, strings=tc.LinearStrings(stiffness=500.0))
    >>> text = tc.exchange.to_mujoco(model, rest_length=0.9 * ball.string_length())
    >>> found = tc.exchange.from_mujoco(text)
    >>> found.structure, bool(np.allclose(found.structure.nodes, ball.nodes, atol=1e-12))
    (Structure(12 nodes, 6 bars, 24 strings), True)
    """
    off = validation.positive_number("tolerance", tolerance, "part of a bar's length", 0.5)
    return _Assembly(MjcfDocument(source), off).imported()


class _Assembly:
    """Puts rigid groups of bodies together as bars, point masses and supports.

    A *spot* is a place of one group: an end of its bar, its point, or a place in the world. Spots
    that joints hold together are one node.
    """

    def __init__(self, document: MjcfDocument, tolerance: float) -> None:
        self.document, self.tolerance = document, tolerance
        self.group = self._groups()
        self.bars: list[tuple[str, int, int, float]] = []  # name, spots, kg
        self.bar_of: dict[int, int] = {}
        self.spots: list[tuple[int, FloatArray]] = []
        self.names: dict[int, list[str]] = {}
        self.joined: list[tuple[int, int]] = []  # pairs of spots
        self.mass: dict[int, float] = {}
        self.rolling: list[tuple[int, int]] = []
        geoms = [geom for body in document.bodies for geom in body.geoms]
        positions = [geom.position for geom in geoms if geom.ends is not None]
        positions += [position for _, position in document.sites.values()]
        if not positions:
            raise ValueError("the MJCF has neither capsules nor sites: no bars, no strings")
        self.size = max(float(np.ptp(positions, axis=0).max()), 1e-300)
        self._cells: dict[tuple[float, ...], list[int]] = {}  # spots by group and place
        self._first_of: dict[int, int] = {}  # spots by group
        self._site_of: dict[int, FloatArray] = {}  # places by group
        for own, position in document.sites.values():
            self._site_of.setdefault(self.group[own], position)
        joints = [joint for body in document.bodies for joint in body.joints]
        self.planar = any(kind == "hinge" for kind, *_ in joints)
        #: Whether all moves in the plane of x and z.
        self.flat = self.planar or (
            bool(joints)
            and all(kind == "slide" and abs(axis[1]) <= _SAME for kind, _, axis in joints)
            and self._off_plane() <= _SAME * self.size
        )

    def imported(self) -> Imported:
        """Return the model."""
        self._bars()
        self._masses()
        self._joints()
        self._constraints()
        paths, groups = self._paths()
        structure, order = self._structure(paths, groups)
        law, rest = self._law(structure, order)
        gravity = self.document.gravity()
        if structure.dimension == 2:
            gravity = gravity[[0, 2]]
        fall = gravity if gravity.any() else None
        planes = [g.name for b in self.document.bodies for g in b.geoms if g.kind == "plane"]
        if planes:
            self._note(
                f"contacts are left out, with the plane {planes[0]!r}: give the model ground"
            )
        return Imported(Model(structure, law, gravity=fall), rest, tuple(self.document.notes))

    def _note(self, note: str) -> None:
        if note not in self.document.notes:
            self.document.notes.append(note)

    def _groups(self) -> list[int]:
        """Return for each body the first of those that it is welded to; 0 is the world."""
        groups: list[int] = []
        for i, body in enumerate(self.document.bodies):
            groups.append(i if body.joints or i == 0 else groups[body.parent])
        return groups

    def _off_plane(self) -> float:
        """Return how far bars, masses and sites are from the plane of x and z at most, m."""
        points = [position for _, position in self.document.sites.values()]
        for body in self.document.bodies:
            points += [geom.position for geom in body.geoms if geom.kind != "plane"]
            points += [end for geom in body.geoms if geom.ends is not None for end in geom.ends]
            points += [body.inertial[1]] if body.inertial is not None else []
        return float(np.abs(np.array(points)[:, 1]).max())

    # ---- spots ----

    def _spot(self, number: int, position: FloatArray, subject: str) -> int:
        """Return the spot of a place on a body, made if it is part of the world or a point."""
        group = self.group[number]
        if group and group in self.bar_of:
            _, start, end, _ = self.bars[self.bar_of[group]]
            ends = np.array([self.spots[start][1], self.spots[end][1]])
            apart = np.linalg.norm(ends - position, axis=1)
            length = float(np.linalg.norm(ends[1] - ends[0]))
            if apart.min() > self.tolerance * length:
                raise ValueError(
                    f"{subject} is {apart.min():.3g} m from the nearer end of its bar "
                    f"{self.bars[self.bar_of[group]][0]!r}, expected at most "
                    f"{self.tolerance * length:.3g} m; give a larger tolerance to put it there"
                )
            return (start, end)[int(apart.argmin())]
        spots = self._spots_at(group, position)
        if spots:
            return spots[0]
        if group and group in self._first_of:
            raise ValueError(
                f"{subject} is on body {self.document.bodies[group].name!r}, which has no bar and "
                "another place already: a body without a capsule is a point here"
            )
        return self._new_spot(group, position)

    def _spots_at(self, group: int, position: FloatArray) -> list[int]:
        """Return the spots of a group at a place."""
        near = (i for key in self._keys(group, position, 1.0) for i in self._cells.get(key, ()))
        off = _SAME * self.size
        return sorted(i for i in near if np.linalg.norm(self.spots[i][1] - position) <= off)

    def _keys(self, group: int, position: FloatArray, reach: float) -> set[tuple[float, ...]]:
        """Return the cells within reach, 1 for one place: at most two along an axis."""
        with np.errstate(over="ignore"):  # far away all is in one cell
            scaled = position / (_SAME * self.size)
            low, high = np.floor((scaled - reach) / 2), np.floor((scaled + reach) / 2)
        along = zip(low.tolist(), high.tolist(), strict=True)
        return {(group, *cell) for cell in product(*along)}

    def _new_spot(self, group: int, position: FloatArray) -> int:
        (key,) = self._keys(group, position, 0.0)
        self._cells.setdefault(key, []).append(len(self.spots))
        self._first_of.setdefault(group, len(self.spots))
        self.spots.append((group, position))
        return len(self.spots) - 1

    def _join(self, one: int, other: int, subject: str) -> None:
        apart = float(np.linalg.norm(self.spots[one][1] - self.spots[other][1]))
        if apart > max(self.tolerance, _SAME) * self.size:
            raise ValueError(f"{subject} joins places {apart:.3g} m apart; give a larger tolerance")
        self.joined.append((one, other))

    # ---- bars and masses ----

    def _bars(self) -> None:
        for i, body in enumerate(self.document.bodies):
            group = self.group[i]
            for geom in body.geoms:
                if geom.ends is None:
                    continue
                if group in self.bar_of and group:
                    raise ValueError(
                        f"body {self.document.bodies[group].name!r} has two bars: bars are joined "
                        "by pins here, not welded into one body"
                    )
                spots = [self._world_or_new(group, end) for end in geom.ends]
                name = geom.name or body.name
                self.bar_of[group] = len(self.bars)
                own = group == 0 or body.inertial is None
                mass = geom.mass if own else self._own_mass(body, geom.ends)
                self.bars.append((name, spots[0], spots[1], mass))

    def _world_or_new(self, group: int, position: FloatArray) -> int:
        if group:
            return self._new_spot(group, position)
        spots = self._spots_at(0, position)
        return spots[0] if spots else self._new_spot(0, position)

    def _own_mass(self, body: Placed, ends: FloatArray) -> float:
        """Return the mass of a bar whose body says it, with its centre in the middle."""
        assert body.inertial is not None  # the caller asked
        mass, centre, moment = body.inertial
        length = float(np.linalg.norm(ends[1] - ends[0]))
        if np.linalg.norm(centre - ends.mean(axis=0)) > max(self.tolerance, _SAME) * length:
            raise ValueError(
                f"body {body.name!r} has its centre of mass off the middle of its bar: give the "
                "bar its own mass, and what it carries a body at its end"
            )
        thin = mass * length**2 / 12
        if abs(moment - thin) > 1e-3 * thin:
            self._note(f"body {body.name!r} has {moment:.4g} kg m² across; a thin bar {thin:.4g}")
        return mass

    def _masses(self) -> None:
        """Put what bodies weigh beside their bars onto their spots."""
        for i, body in enumerate(self.document.bodies):
            if self.group[i] == 0:
                continue
            own = any(geom.ends is not None for geom in body.geoms)
            masses: list[tuple[float, FloatArray, str]] = []
            if body.inertial is None:
                masses = [(g.mass, g.position, g.name) for g in body.geoms if g.ends is None]
            elif not own:
                masses = [(body.inertial[0], body.inertial[1], body.name)]
            for mass, position, name in masses:
                if mass > 0:
                    spot = self._spot(i, position, f"the mass of {name or body.name!r}")
                    self.mass[spot] = self.mass.get(spot, 0.0) + mass

    # ---- joints ----

    def _joints(self) -> None:
        for i, body in enumerate(self.document.bodies):
            if not body.joints:
                continue
            kinds = [kind for kind, *_ in body.joints]
            slides = [axis for kind, _, axis in body.joints if kind == "slide"]
            turning = [position for kind, position, _ in body.joints if kind in ("ball", "hinge")]
            self._refuse_joints(body, kinds, len(turning), i)
            if kinds == ["free"]:
                if i not in self.bar_of:
                    self._spot(i, self._point(i), f"body {body.name!r}")
                continue
            position = turning[0] if turning else self._point(i)
            held = self._held(body, slides) if slides else [0, 1, 2]
            if len(slides) and not len(held):
                if i not in self.bar_of:
                    self._spot(i, position, f"body {body.name!r}")
                continue
            spot = self._spot(i, position, f"the joint of body {body.name!r}")
            if slides:
                self.rolling += [(spot, axis) for axis in held]
            else:
                where = f"the joint of body {body.name!r}"
                self._join(spot, self._spot(body.parent, position, where), where)

    def _refuse_joints(self, body: Placed, kinds: list[str], turning: int, number: int) -> None:
        allowed = {"free", "ball", "hinge", "slide"}
        name = f"body {body.name!r}"
        if not set(kinds) <= allowed or turning > 1 or ("free" in kinds and len(kinds) > 1):
            raise ValueError(f"{name} has the joints {', '.join(kinds)}, which no bar has")
        if ("slide" in kinds or "free" in kinds) and self.group[body.parent]:
            raise ValueError(f"{name} slides on another body: only supports can have slides")
        if self.planar and {"ball", "free"} & set(kinds):
            raise ValueError(
                f"{name} moves in space, and others have hinges: bars have ball joints"
            )
        for kind, _, axis in body.joints:
            if kind == "hinge" and abs(axis[1]) < 1 - _SAME:
                raise ValueError(
                    f"{name} has a hinge about {np.round(axis, 4)}: only hinges about y, of a "
                    "planar structure in x and z, are understood; bars in space have ball joints"
                )
        if number in self.bar_of and not turning and "free" not in kinds:
            raise ValueError(f"{name} has a bar that cannot turn, only slide")
        if number not in self.bar_of and turning and len(kinds) == 1:
            raise ValueError(f"{name} turns, and has no capsule or cylinder: no bar")

    def _point(self, number: int) -> FloatArray:
        """Return where a body without a bar is: at its spot, else at its site or its origin."""
        if number in self._first_of:
            return self.spots[self._first_of[number]][1]
        return self._site_of.get(number, self.document.bodies[number].position)

    def _held(self, body: Placed, slides: Sequence[FloatArray]) -> list[int]:
        """Return the axes along which slides do not let a body move."""
        every = [0, 2] if self.flat else [0, 1, 2]
        if np.linalg.matrix_rank(slides) < len(slides):
            raise ValueError(f"body {body.name!r} slides twice along one axis")
        span = np.linalg.qr(np.array(slides).T)[0]
        along = np.linalg.norm(span, axis=1)  # of each axis, the part that is free
        askew = (along > _SAME) & (along < 1 - _SAME)
        if askew.any():
            raise ValueError(
                f"body {body.name!r} slides along {np.round(slides[0], 4)}, and not along all "
                "axes: what rollers hold is an axis"
            )
        return [axis for axis in every if along[axis] <= _SAME]

    def _constraints(self) -> None:
        for element, given in self.document.members("equality"):
            if element.tag != "connect":
                raise ValueError(f"the MJCF has the constraint <{element.tag}>, which no bar has")
            subject = f"the constraint {given.get('name', 'connect')!r}"
            if "site1" in given:
                sites = (self._site(given.get(name, "")) for name in ("site1", "site2"))
                spots = [self._spot(*site, subject) for site in sites]
            else:
                number = self.document.numbered(given.get("body1", ""))
                other = self.document.numbered(given.get("body2", "world"))
                body = self.document.bodies[number]
                position = body.position + body.rotation @ numbers(given, "anchor", 3)
                spots = [self._spot(i, position, subject) for i in (number, other)]
            self._join(spots[0], spots[1], subject)

    def _site(self, name: str) -> tuple[int, FloatArray]:
        if name not in self.document.sites:
            raise ValueError(f"the MJCF names the site {name!r}, which it does not have")
        return self.document.sites[name]

    # ---- strings ----

    def _paths(self) -> tuple[list[list[int]], list[str]]:
        """Return the spots that each tendon runs over, and the group of each."""
        paths, groups = [], []
        self.tendons: list[tuple[Element, dict[str, str]]] = []
        actuated = {given.get("tendon") for _, given in self.document.members("actuator")}
        tendons = self.document.members("tendon")
        pulling = [  # the others measure; a string of γ = 0 has a range of lengths without force
            any(row(given, "stiffness"))
            or len(row(given, "springlength")) == 2
            or given.get("name", "") in actuated
            for _, given in tendons
        ]
        for (element, given), pulls in zip(tendons, pulling, strict=True):
            tendon = f"tendon {given.get('name', '')!r}"
            if any(pulling) and not pulls:
                self._note(f"{tendon} pulls by nothing and is left out")
                continue
            if element.tag != "spatial":
                raise ValueError(f"{tendon} is <{element.tag}>, not spatial")
            path = []
            for point in element:
                if point.tag != "site":
                    raise ValueError(f"{tendon} runs over a <{point.tag}>, expected sites")
                name = point.get("site", "")
                spot = self._spot(*self._site(name), f"site {name!r}")
                self.names.setdefault(spot, []).append(name)
                path.append(spot)
            for lost in _LOST:
                if any(row(given, lost)):
                    self._note(f"{lost} of tendons is left out")
            paths.append(path)
            group = element.get("class", "").removeprefix("string-")
            groups.append(group if group.isidentifier() else "string")
            self.tendons.append((element, given))
        return paths, groups

    def _nodes(self) -> tuple[list[int], list[int]]:
        """Return the first spot of each node, in the order of their names, and each spot's node."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        count, pairs = len(self.spots), np.array(self.joined, dtype=np.int64).reshape(-1, 2)
        graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(count, count))
        _, component = connected_components(graph, directed=False)
        _, firsts = np.unique(component, return_index=True)
        names: list[list[str]] = [[] for _ in firsts]
        for spot, own in self.names.items():
            names[component[spot]] += own
        order = np.argsort(firsts)
        order = order[_numbered([min(names[i], default="") for i in order])]
        return firsts[order].tolist(), np.argsort(order)[component].tolist()

    def _structure(self, paths: list[list[int]], groups: list[str]) -> tuple[Structure, list[int]]:
        """Return the structure, and the order of its strings among the tendons."""
        for name, (body, where) in self.document.sites.items():  # of nodes without strings
            if self.group[body] in self.bar_of or self.group[body] == 0:
                for spot in self._spots_at(self.group[body], where):
                    self.names.setdefault(spot, []).append(name)
        if not self.spots:
            raise ValueError("the MJCF has sites, and neither capsules nor tendons over them")
        firsts, node_of = self._nodes()
        bars = [self.bars[i] for i in _numbered([bar[0] for bar in self.bars])]
        order = _numbered([given.get("name", "") for _, given in self.tendons])
        keep = [0, 2] if self.flat else [0, 1, 2]
        N = np.array([self.spots[first][1] for first in firsts]).T
        if len(keep) == 2 and np.abs(N[1]).max(initial=0.0) > _SAME * self.size:
            raise ValueError("the MJCF has hinges, and nodes off the plane of x and z")
        mass = np.zeros(len(firsts))
        for spot, kg in self.mass.items():
            mass[node_of[spot]] += kg
        held = {node_of[i] for i, (group, _) in enumerate(self.spots) if group == 0}
        fixed = sorted(held)
        mass[fixed] = 0.0
        rollers = [(node_of[spot], "xyz"[keep.index(axis)]) for spot, axis in self.rolling]
        structure = Structure(
            N[keep],
            np.array([(node_of[start], node_of[end]) for _, start, end, _ in bars]).reshape(-1, 2),
            [[node_of[spot] for spot in paths[i]] for i in order],
            [kg for *_, kg in bars],
            string_groups=[groups[i] for i in order],
            fixed=fixed,
            rollers=[pair for pair in rollers if pair[0] not in held],
            point_mass=mass if mass.any() else None,
        )
        return structure, order

    def _law(
        self, structure: Structure, order: list[int]
    ) -> tuple[StringLaw | None, FloatArray | None]:
        """Return the string law and the rest lengths, as far as tendons and actuators say them."""
        driven = self._driven()
        given = [self._spring(self.tendons[i][1], driven) for i in order]
        if not given or any(spring is None for spring in given):
            if given:
                self._note("strings have no stiffness: a model of force densities")
            return None, None
        springs = [spring for spring in given if spring is not None]
        kinds = {elastic for elastic, *_ in springs}
        if len(kinds) > 1:
            raise ValueError("some tendons have constant stiffness, others constant rigidity")
        values, damping = np.array([spring[1:3] for spring in springs]).T
        law = (ElasticStrings if kinds.pop() else LinearStrings)(values, damping)
        length = structure.string_length()
        rest = [own if own >= 0 else float(length[i]) for i, (*_, own) in enumerate(springs)]
        if min(rest) == 0:
            self._note(
                "strings of rest length 0 have constant force density, which is their stiffness"
            )
            return None, None
        return law, np.array(rest)

    def _driven(self) -> dict[str, tuple[bool, float, float]]:
        """Return, by tendon, whether an actuator has constant EA, its stiffness and damping."""
        driven = {}
        for element, given in self.document.members("actuator"):
            name = given.get("tendon")
            gain = [*row(given, "gainprm", "1"), 0.0, 0.0, 0.0]
            bias = [*row(given, "biasprm"), 0.0, 0.0, 0.0]
            if element.tag == "position" and name:
                driven[name] = False, number(given, "kp", "1"), number(given, "kv", "0")
            elif element.tag == "general" and name and given.get("biastype") == "affine":
                elastic = given.get("gaintype") == "affine"
                driven[name] = elastic, bias[0] if elastic else gain[0], -bias[2]
            elif name:
                self._note("actuators that set forces are left out")
        return driven

    def _spring(
        self, given: dict[str, str], driven: dict[str, tuple[bool, float, float]]
    ) -> tuple[bool, float, float, float] | None:
        """Return rigidity or not, stiffness, damping and rest length; -1 where it is the length."""
        spring = row(given, "springlength") or [-1.0]
        name = given.get("name", "")
        if name in driven:
            return (*driven[name], spring[-1])
        stiffness, damping = (row(given, key) or [0.0] for key in ("stiffness", "damping"))
        if any(stiffness[1:]):
            raise ValueError(f"tendon {name!r} has stiffness that changes with its length")
        if not stiffness[0]:
            return None
        if len(spring) == 1 or spring[0] > 0:
            self._note("tendons that push when they are short become strings that do not")
        return False, stiffness[0], damping[0], spring[-1]


def _numbered(names: Sequence[str]) -> list[int]:
    """Return the order by the numbers that names end in, if all have one of their own."""
    matches = [re.search(r"(\d+)$", name[-_DIGITS:]) for name in names]
    ends = [int(match.group(1)) for match in matches if match]
    if len(ends) < len(names) or len(set(ends)) < len(names):
        return list(range(len(names)))
    return sorted(range(len(names)), key=ends.__getitem__)
