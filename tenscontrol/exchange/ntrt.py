"""Structures of the NASA Tensegrity Robotics Toolkit, written in YAML."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol.dynamics import LinearStrings, Model
from tenscontrol.exchange.imported import Imported
from tenscontrol.files import read_text
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, file_path, positive_number

# What builders are without parameters.
_ROD = {"radius": 0.5, "density": 1.0}
_STRING = {"stiffness": 1000.0, "damping": 10.0, "pretension": 0.0}
_BUILDERS = {
    "tgRodInfo": _ROD, "tgBasicActuatorInfo": _STRING, "tgBasicContactCableInfo": _STRING,
    "tgKinematicActuatorInfo": _STRING, "tgKinematicContactCableInfo": _STRING,
}  # fmt: skip
_SECTIONS = ("nodes", "pair_groups", "builders", "substructures", "bond_groups")
_PLACEMENT = ("path", "rotation", "translation", "scale", "offset")

# Files within files.
_MOST_DEPTH = 50
# Levels within a file, and its bytes.
_MOST_LEVELS, _MOST_BYTES = 20, 10_000_000
# Values in all files together, each time that one is read: of 25,000 members. A file counts as 50
# of them, and 100 bytes as one, since they take as long.
_MOST_VALUES, _OF_FILE, _BYTES_OF_VALUE = 100_000, 50, 100


def from_ntrt(path: object, length_unit: float = 1.0) -> Imported:
    """Return the model of a structure file of NTRT, the NASA Tensegrity Robotics Toolkit.

    Pairs of ``pair_groups`` and of ``node_node`` bonds are built by the ``builders`` whose tags
    they have: rods become bars, cables strings. ``substructures`` are read from their own files,
    rotated, scaled and moved. YAML is read by PyYAML, ``pip install 'tenscontrol[yaml]'``.

    Parameters
    ----------
    path : str or path
        Of the top file; others are found beside it.
    length_unit : float
        What one unit of length of the file is, m. NTRT's models are often in decimetres, 0.1.

    Returns
    -------
    Imported
        Bars with the mass of rods, ``π r² density`` times length; strings with stiffness and
        damping, and rest lengths by their pretension.

    Raises
    ------
    ImportError
        If PyYAML is not installed.
    OSError
        If a file cannot be read.
    ValueError
        If a file is not such YAML, or has what is not understood: builders of boxes and spheres,
        ``node_edge`` bonds. The message names it.

    Notes
    -----
    NTRT's y points up: give the model ``gravity=[0, -9.81, 0]``. Rods that share a node are welded
    in NTRT and pinned here, and its cables end at the surface of rods; ``notes`` says so. Friction,
    restitution and the limits of motors are left out.

    References
    ----------
    The format: ``TensegrityModel`` in https://github.com/NASA-Tensegrity-Robotics-Toolkit/NTRTsim

    Examples
    --------
    >>> import pathlib, tempfile, tenscontrol as tc
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "cross.yaml"
    >>> _ = file.write_text('''
    ... nodes: {a: [0, 0, 0], b: [0, 5, 0], c: [5, 5, 1], d: [5, 0, 1]}
    ... pair_groups:
    ...   rod: [[a, c], [b, d]]
    ...   cable: [[a, b], [b, c], [c, d], [d, a]]
    ... builders:
    ...   rod: {class: tgRodInfo, parameters: {density: 0.7, radius: 0.3}}
    ...   cable: {class: tgBasicActuatorInfo, parameters: {stiffness: 1000, pretension: 500}}
    ... ''')
    >>> tc.exchange.from_ntrt(file).structure
    Structure(4 nodes, 2 bars, 4 strings)
    """
    unit = positive_number("length_unit", length_unit, "m")
    builders: dict[str, dict[str, Any]] = {}
    top = _Files(builders).read(file_path("path", path))
    return _model(top, builders, unit, Path(str(path)))


@dataclass
class _Part:
    """A structure of a file, with its substructures by name."""

    name: str = ""
    nodes: dict[str, FloatArray] = field(default_factory=dict)
    pairs: list[tuple[str, _Part, str, _Part, str]] = field(default_factory=list)
    parts: dict[str, _Part] = field(default_factory=dict)

    def every(self) -> Iterator[_Part]:
        """Yield this part and all within."""
        yield self
        for part in self.parts.values():
            yield from part.every()

    def move(self, change: Any) -> None:
        """Replace all nodes by what a function makes of them."""
        for part in self.every():
            part.nodes = {name: change(at) for name, at in part.nodes.items()}

    def centroid(self) -> FloatArray:
        """Return the mean of all nodes."""
        every = [at for part in self.every() for at in part.nodes.values()]
        return np.asarray(np.mean(every, axis=0))

    def find(self, path: str, where: str) -> tuple[_Part, str]:
        """Return the part and the name of a node such as ``child.node``, or of one within."""
        part: _Part = self
        *parents, name = path.split(".")
        for each in parents:
            if each not in part.parts:
                raise ValueError(f"{where} names the substructure {each!r}, which is not there")
            part = part.parts[each]
        for inner in part.every():
            if name in inner.nodes:
                return inner, name
        raise ValueError(f"{where} names the node {path!r}, which is not there")


@dataclass
class _Files:
    """The files of a structure: their builders, and how many values they may still have."""

    builders: dict[str, dict[str, Any]]
    left: int = _MOST_VALUES

    def read(self, path: Path, above: tuple[Path, ...] = ()) -> _Part:
        """Return the structure of a file; its builders come after those of its substructures."""
        place = Path(os.path.realpath(path))
        if place in above:
            raise ValueError(f"{path} is a substructure of itself")
        if len(above) == _MOST_DEPTH:
            raise ValueError(f"{path} is a substructure within {_MOST_DEPTH} others, the most")
        root = _mapping(self._yaml(path), str(path), _SECTIONS)
        part = _Part()
        placed = _mapping(root.get("substructures"), f"{path}: substructures")
        for names, given in placed.items():
            placement = _mapping(given, f"{path}: {names}", _PLACEMENT)
            for name in names.split("/"):
                file = path.parent / _text(placement.get("path"), f"{path}: {names}: path")
                part.parts[name] = self.read(file, (*above, place))
                part.parts[name].name = name
        for names, given in placed.items():
            for k, name in enumerate(names.split("/")):
                _place(part.parts[name], given, k, f"{path}: {names}")
        for tag, given in _mapping(root.get("builders"), f"{path}: builders").items():
            self.builders.pop(tag, None)  # the last counts
            self.builders[tag] = _builder(given, f"{path}: builder {tag!r}")
        for name, at in _mapping(root.get("nodes"), f"{path}: nodes").items():
            part.nodes[name] = _vector(at, f"{path}: node {name!r}")
        for tags, pairs in _mapping(root.get("pair_groups"), f"{path}: pair_groups").items():
            where = f"{path}: {tags}"
            for start, end in _pairs(pairs, where):
                part.pairs.append((tags, *part.find(start, where), *part.find(end, where)))
        for one, inner in _mapping(root.get("bond_groups"), f"{path}: bond_groups").items():
            for other, pairs in _mapping(inner, f"{path}: {one}").items():
                tags, bond = (one, other) if "/" in other else (other, one)
                _bond(part, tags, bond, pairs, f"{path}: {bond}")
        return part

    def _yaml(self, path: Path) -> object:
        """Return a YAML file with all scalars as text, as NTRT reads it; duplicates are refused."""
        try:
            import yaml
        except ImportError:
            raise ImportError(
                "from_ntrt needs PyYAML, which is not installed: pip install 'tenscontrol[yaml]'"
            ) from None
        try:
            text = read_text(path, _MOST_BYTES)
            self._spend(_OF_FILE + len(text) // _BYTES_OF_VALUE, path)
            if sum(text.count(sign) for sign in "[{,:-\n") > 4 * _MOST_VALUES:
                self._spend(_MOST_VALUES, path)
            node = yaml.compose(text, Loader=yaml.BaseLoader)
            self._count(node, path, _MOST_LEVELS)
            return None if node is None else yaml.BaseLoader("").construct_object(node, deep=True)
        except RecursionError:
            raise ValueError(f"{path} is not YAML that is read: it is nested too deep") from None
        except yaml.YAMLError as error:
            raise ValueError(f"{path} is not YAML: {' '.join(str(error).split())}") from None

    def _spend(self, values: int, path: Path) -> None:
        self.left -= values
        if self.left < 0:
            raise ValueError(
                f"{path} is of a structure that is too large: at most {_MOST_VALUES:,} values in "
                f"all files and aliases are read, and a file counts as {_OF_FILE} of them"
            )

    def _count(self, node: Any, path: Path, levels: int) -> None:
        """Count the values of a file, those of an alias each time, and refuse keys that repeat."""
        self._spend(1, path)
        if not levels:
            raise ValueError(f"{path} is nested deeper than {_MOST_LEVELS} levels")
        if node is None or node.id == "scalar":
            return
        if node.id == "mapping":
            keys = Counter(str(key.value) for key, _ in node.value)
            twice = [key for key, count in keys.items() if count > 1]
            if twice:
                raise ValueError(f"{path} has {twice[0]!r:.60} twice in one place")
        for child in node.value:
            for each in child if isinstance(child, tuple) else (child,):
                self._count(each, path, levels - 1)


def _bond(part: _Part, tags: str, bond: str, pairs: object, where: str) -> None:
    """Add pairs between each substructure of a bond and the next."""
    *names, kind = bond.split("/")
    if kind != "node_node" or len(names) < 2:
        raise ValueError(f"{where} is a bond of another kind than node_node, which is understood")
    for name in names:
        if name not in part.parts:
            raise ValueError(f"{where} names the substructure {name!r}, which is not there")
    for first, second in pairwise(names):
        for start, end in _pairs(pairs, where):
            found = part.parts[first].find(start, where), part.parts[second].find(end, where)
            part.pairs.append((f"{tags} {first} {second}", *found[0], *found[1]))


def _place(part: _Part, given: Mapping[str, Any], number: int, where: str) -> None:
    """Rotate, then scale about the centroid, then move."""
    from scipy.spatial.transform import Rotation

    rotation = _mapping(given.get("rotation"), where, ("reference", "axis", "angle"))
    if "axis" in rotation and "angle" in rotation:
        axis = _vector(rotation["axis"], f"{where}: axis")
        if not axis.any():
            raise ValueError(f"{where}: axis is 0, expected a direction")
        angle = np.deg2rad(_number(rotation["angle"], f"{where}: angle"))
        turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        about = part.centroid()
        if "reference" in rotation:
            about = _vector(rotation["reference"], f"{where}: reference")
        part.move(lambda at: about + turn @ (at - about))
    if "scale" in given:
        size, centre = _number(given["scale"], f"{where}: scale"), part.centroid()
        part.move(lambda at: centre + size * (at - centre))
    for key, times in (("offset", number), ("translation", 1)):
        if key in given:
            shift = times * _vector(given[key], f"{where}: {key}")
            part.move(lambda at, shift=shift: at + shift)


def _builder(given: object, where: str) -> dict[str, Any]:
    found = _mapping(given, where, ("class", "parameters"))
    kind = _text(found.get("class"), f"{where}: class")
    if kind not in _BUILDERS:
        raise ValueError(f"{where} is of the class {kind}, expected one of {', '.join(_BUILDERS)}")
    values = _BUILDERS[kind] | {
        name: _number(value, f"{where}: {name}")
        for name, value in _mapping(found.get("parameters"), where).items()
        if name in _BUILDERS[kind]
    }
    return values | {"is_rod": _BUILDERS[kind] is _ROD}


def _model(top: _Part, builders: dict[str, dict[str, Any]], unit: float, path: Path) -> Imported:
    """Return the model of all pairs that a builder builds; the others are for looks."""
    place: dict[tuple[int, str], FloatArray] = {}
    for part in top.every():
        place |= {(id(part), name): at for name, at in part.nodes.items()}
    bars: list[tuple[tuple[int, str], tuple[int, str], float]] = []
    strings: list[tuple[tuple[int, str], tuple[int, str], dict[str, Any], str]] = []
    notes: list[str] = []
    needed = {tag: set(tag.split()) for tag in builders}
    fitting: dict[tuple[str, str], list[str]] = {}  # builders by tags and name of the part
    for part in top.every():
        for tags, first, start, second, end in part.pairs:
            if (tags, part.name) not in fitting:
                own = {*tags.split(), part.name}
                fitting[tags, part.name] = [tag for tag, words in needed.items() if words <= own]
            matching = fitting[tags, part.name]
            rods = [tag for tag in matching if builders[tag]["is_rod"]]
            if not matching:
                notes.append(f"the pair {start}, {end} of {tags!r} has no builder and is left out")
                continue
            tag = (rods or matching)[-1]
            ends = (id(first), start), (id(second), end)
            if rods:
                length = float(np.linalg.norm(place[ends[1]] - place[ends[0]]))
                area = np.pi * builders[tag]["radius"] ** 2
                bars.append((*ends, area * builders[tag]["density"] * length))
            else:
                strings.append((*ends, builders[tag], tag))
    on_rods = dict.fromkeys(end for bar in bars for end in bar[:2])
    used = on_rods | dict.fromkeys(end for string in strings for end in string[:2])
    if not used:
        raise ValueError(f"{path} has no pair that a builder builds: no bars, no strings")
    bare = [name for own, name in place if (own, name) not in used]
    if bare:
        notes.append(f"nodes without members are left out: {', '.join(bare)}")
    loose = [name for own, name in used if (own, name) not in on_rods]
    if loose:
        raise ValueError(f"{path}: node {loose[0]!r} is on cables alone; give it a rod")
    number = {key: i for i, key in enumerate(key for key in place if key in used)}
    structure = Structure(
        unit * np.array([place[key] for key in number]).T,
        np.array([(number[start], number[end]) for start, end, _ in bars]).reshape(-1, 2),
        np.array([(number[start], number[end]) for start, end, *_ in strings]).reshape(-1, 2),
        [mass for *_, mass in bars],
        string_groups=["_".join(tag.split()) for *_, tag in strings],
    )
    if structure.structure_class > 1:
        notes.append("rods that share a node are welded in NTRT and pinned here")
    if not strings:
        return Imported(Model(structure), None, tuple(notes))
    notes.append("cables end at nodes, not at the surface of rods")
    law = LinearStrings(*([given[key] for *_, given, _ in strings] for key in
                          ("stiffness", "damping")))  # fmt: skip
    pretension = unit * np.array([given["pretension"] for *_, given, _ in strings])
    rest = structure.string_length() - pretension / law.stiffness
    if rest.min() <= 0:
        i = int(rest.argmin())
        raise ValueError(
            f"the pretension of string {i} ({strings[i][3]!r}) is {pretension[i]:g} N, which "
            f"stretches it by more than its length {structure.string_length()[i]:g} m"
        )
    return Imported(Model(structure, law), rest, tuple(notes))


# ---- values of YAML ----


def _mapping(value: object, where: str, known: tuple[str, ...] = ()) -> dict[str, Any]:
    if value is None or value == "":
        return {}
    if not isinstance(value, dict):
        raise ValueError(f"{where} is {value!r:.60}, expected names with values")
    unknown = [key for key in value if known and key not in known]
    if unknown:
        raise ValueError(f"{where} has {unknown[0]!r}, expected {', '.join(known)}")
    return value


def _text(value: object, where: str) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError(f"{where} is {value!r:.60}, expected text")
    return value


def _number(value: object, where: str) -> float:
    try:
        found = float(_text(value, where))
    except ValueError:
        found = np.nan
    if not np.isfinite(found):
        raise ValueError(f"{where} is {value!r:.60}, expected a number")
    return found


def _vector(value: object, where: str) -> FloatArray:
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{where} is {value!r:.60}, expected [x, y, z]")
    return np.array([_number(entry, where) for entry in value])


def _pairs(value: object, where: str) -> list[tuple[str, str]]:
    if value is None or value == "":
        return []
    found = []
    for pair in value if isinstance(value, list) else [None]:
        if not isinstance(pair, list) or len(pair) != 2:
            raise ValueError(f"{where} has {pair!r:.60}, expected pairs of nodes [a, b]")
        found.append((_text(pair[0], where), _text(pair[1], where)))
    return found
