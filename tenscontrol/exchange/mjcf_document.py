"""MJCF parsed: defaults filled in, bodies placed in space, geoms measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray
from tenscontrol.files import read_text

# Elements that say nothing of the motion.
_IGNORED = {
    "asset", "camera", "compiler", "contact", "custom", "default", "keyframe", "light", "option",
    "plugin", "sensor", "size", "statistic", "visual",
}  # fmt: skip
_READ = {"worldbody", "tendon", "actuator", "equality"}
# Elements of which defaults are read.
_DEFAULTED = {
    "joint", "geom", "site", "equality", "tendon", "general", "motor", "position", "velocity",
    "intvelocity", "damper", "cylinder", "muscle", "adhesion",
}  # fmt: skip

# Attributes of joints that bars do not have.
_OF_JOINTS = ("stiffness", "damping", "armature", "frictionloss", "range")

# Of a file. MuJoCo reads no deeper levels either; 500,000 elements are about 70,000 bars.
_MOST_BYTES, _MOST_DEPTH, _MOST_ELEMENTS, _MOST_ATTRIBUTES = 100_000_000, 500, 500_000, 100
# Of an attribute that holds numbers.
_MOST_LETTERS = 1_000

# kg/m³ of geoms without a mass.
_DENSITY = "1000"


@dataclass(frozen=True)
class Geom:
    """A geom in space: ``ends`` of capsules and cylinders, mass in kg."""

    name: str
    kind: str
    position: FloatArray
    ends: FloatArray | None  # (2, 3)
    mass: float


@dataclass
class Placed:
    """A body in space; index 0 is the world."""

    name: str
    parent: int
    rotation: FloatArray  # (3, 3)
    position: FloatArray
    joints: list[tuple[str, FloatArray, FloatArray]] = field(default_factory=list)
    geoms: list[Geom] = field(default_factory=list)
    inertial: tuple[float, FloatArray, float] | None = None  # kg, place, mean moment in kg m²


class MjcfDocument:
    """The bodies, sites, tendons, actuators and constraints of a file."""

    def __init__(self, source: object) -> None:
        self.root = _root(source)
        self.notes: list[str] = []
        compiler = self._child("compiler")
        if compiler.get("coordinate", "local") != "local":
            raise ValueError(
                "the MJCF has coordinate='global', which MuJoCo dropped in 2.3.4: load and save it "
                "with one before"
            )
        self._degrees = compiler.get("angle", "degree") == "degree"
        self._sequence = compiler.get("eulerseq", "xyz")
        if len(self._sequence) != 3 or not set(self._sequence.lower()) <= set("xyz"):
            raise ValueError(f"the MJCF has eulerseq={self._sequence!r}, expected as xyz")
        self._defaults: dict[str, dict[str, dict[str, str]]] = {}
        for default in self.root.findall("default"):
            self._read_defaults(default, default.get("class", "main"), {})
        self.bodies = [Placed("world", 0, np.eye(3), np.zeros(3))]
        self.sites: dict[str, tuple[int, FloatArray]] = {}
        self._numbers: dict[str, int] = {"world": 0}
        for element in self.root:
            if element.tag == "worldbody":
                self._read_body(element, 0, "main")
            elif element.tag not in _IGNORED | _READ:
                raise ValueError(f"the MJCF has <{element.tag}>, which is not understood")

    def numbered(self, name: str) -> int:
        """Return the number of a body by name."""
        if name not in self._numbers:
            raise ValueError(f"the MJCF names the body {name!r}, which it does not have")
        return self._numbers[name]

    def members(self, section: str) -> list[tuple[Element, dict[str, str]]]:
        """Return the elements of a section with all their attributes."""
        elements = []
        for block in self.root.findall(section):
            for element in block:
                kind = section if section in ("tendon", "equality") else element.tag
                elements.append((element, self._attributes(element, "main", kind)))
        return elements

    def gravity(self) -> FloatArray:
        """Return the acceleration of free fall, m/s²."""
        return numbers(self._child("option").attrib, "gravity", 3, "0 0 -9.81")

    def _child(self, tag: str) -> Element:
        child = self.root.find(tag)
        return Element(tag) if child is None else child

    # ---- defaults ----

    def _read_defaults(
        self, default: Element, name: str, inherited: dict[str, dict[str, str]]
    ) -> None:
        own = dict(inherited)
        for element in default:
            if element.tag in _DEFAULTED:
                own[element.tag] = own.get(element.tag, {}) | element.attrib
        self._defaults[name] = own
        for element in default.findall("default"):
            self._read_defaults(element, element.get("class", ""), own)

    def _attributes(self, element: Element, around: str, kind: str = "") -> dict[str, str]:
        name = element.get("class", around)
        if name not in self._defaults and name != "main":
            raise ValueError(f"the MJCF uses the class {name!r}, which it does not define")
        return self._defaults.get(name, {}).get(kind or element.tag, {}) | element.attrib

    # ---- bodies ----

    def _read_body(self, element: Element, number: int, around: str) -> None:
        body = self.bodies[number]
        around = element.get("childclass", around)
        for child in element:
            given = self._attributes(child, around)
            if child.tag == "body":
                rotation, position = self._frame(given, body)
                name = given.get("name", f"body {len(self.bodies)}")
                self._numbers[name] = len(self.bodies)
                self.bodies.append(Placed(name, number, rotation, position))
                self._read_body(child, len(self.bodies) - 1, around)
            elif child.tag in ("joint", "freejoint"):
                kind = "free" if child.tag == "freejoint" else given.get("type", "hinge")
                anchor = body.position + body.rotation @ numbers(given, "pos", 3, "0 0 0")
                axis = body.rotation @ numbers(given, "axis", 3, "0 0 1")
                body.joints.append((kind, anchor, _unit(axis, "an axis")))
                if any(any(row(given, key)) for key in _OF_JOINTS):
                    self.notes.append(f"springs and friction of {body.name!r}'s joint are left out")
            elif child.tag == "geom":
                body.geoms.append(self._geom(given, body))
            elif child.tag == "site":
                if "name" in given:
                    self.sites[given["name"]] = number, self._frame(given, body)[1]
            elif child.tag == "inertial":
                if self._child("compiler").get("inertiafromgeom") != "true":
                    body.inertial = self._inertial(given, body)
            elif child.tag not in _IGNORED:
                raise ValueError(
                    f"body {body.name!r} of the MJCF has <{child.tag}>, which is not understood"
                )

    def _frame(self, given: dict[str, str], body: Placed) -> tuple[FloatArray, FloatArray]:
        position = body.position + body.rotation @ numbers(given, "pos", 3, "0 0 0")
        return body.rotation @ self._rotation(given), position

    def _rotation(self, given: dict[str, str]) -> FloatArray:
        """Return the rotation that an element gives in one of MuJoCo's ways, shape (3, 3)."""
        from scipy.spatial.transform import Rotation

        if "quat" in given:
            w, x, y, z = _unit(numbers(given, "quat", 4), "a quaternion")
            return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())
        if "euler" in given:
            angles = numbers(given, "euler", 3)
            # Small letters are axes that turn along, which SciPy writes in capitals.
            rotation = Rotation.from_euler(self._sequence.swapcase(), angles, degrees=self._degrees)
            return np.asarray(rotation.as_matrix())
        if "axisangle" in given:
            *axis, angle = numbers(given, "axisangle", 4)
            unit = _unit(np.array(axis), "an axis")
            angle = np.deg2rad(angle) if self._degrees else angle
            return np.asarray(Rotation.from_rotvec(angle * unit).as_matrix())
        if "xyaxes" in given:
            x, y = numbers(given, "xyaxes", 6).reshape(2, 3)
            x = _unit(x, "an axis")
            y = _unit(y - (x @ y) * x, "an axis")
            return np.column_stack([x, y, np.cross(x, y)])
        if "zaxis" in given:
            z = _unit(numbers(given, "zaxis", 3), "an axis")
            return np.asarray(Rotation.align_vectors([z], [[0, 0, 1]])[0]
                              .as_matrix())  # fmt: skip
        return np.eye(3)

    def _geom(self, given: dict[str, str], body: Placed) -> Geom:
        kind, name = given.get("type", "sphere"), given.get("name", "")
        rotation, position = self._frame(given, body)
        size = row(given, "size") or [0.0]
        ends = None
        if kind in ("capsule", "cylinder"):
            if "fromto" in given:
                local = numbers(given, "fromto", 6).reshape(2, 3)
                ends = body.position + local @ body.rotation.T
            elif len(size) > 1:
                ends = position + np.outer([-size[1], size[1]], rotation[:, 2])
            else:
                raise ValueError(f"geom {name!r} has neither fromto nor a half-length in size")
            position = ends.mean(axis=0)
        if "mass" in given:
            mass = number(given, "mass")
        else:
            density = number(given, "density", _DENSITY)
            counts = density and (ends is not None or body is not self.bodies[0])
            mass = density * _volume(kind, size, ends) if counts else 0.0
        return Geom(name, kind, position, ends, mass)

    def _inertial(self, given: dict[str, str], body: Placed) -> tuple[float, FloatArray, float]:
        _, position = self._frame(given, body)
        moments = (row(given, "diaginertia") or row(given, "fullinertia", "0 0 0"))[:3]
        # Of a thin bar two are equal and the third less, or made equal.
        return number(given, "mass"), position, float(np.median(moments))


def _volume(kind: str, size: list[float], ends: FloatArray | None) -> float:
    """Return the volume of a geom, m³; 0 of planes and what is only drawn."""
    if kind in ("capsule", "cylinder") and ends is not None:
        r, length = size[0], float(np.linalg.norm(ends[1] - ends[0]))
        return np.pi * r**2 * length + (4 / 3 * np.pi * r**3 if kind == "capsule" else 0.0)
    if kind == "sphere":
        return 4 / 3 * np.pi * size[0] ** 3
    if kind == "box" and len(size) == 3:
        return float(8 * np.prod(size))
    if kind == "ellipsoid" and len(size) == 3:
        return float(4 / 3 * np.pi * np.prod(size))
    if kind == "plane":
        return 0.0
    raise ValueError(f"the mass of a geom of type {kind!r} is not known: give it mass")


def row(given: Mapping[str, str], key: str, default: str = "") -> list[float]:
    """Return the numbers of an attribute, or of what it is if it is not given."""
    text = given.get(key, default)
    try:
        values = [float(word) for word in text.split()] if len(text) <= _MOST_LETTERS else [np.nan]
    except ValueError:
        values = [np.nan]
    if not np.isfinite(values).all():
        raise ValueError(f"the MJCF has {key}={text!r:.60}, expected numbers")
    return values


def numbers(given: Mapping[str, str], key: str, count: int, default: str = "") -> FloatArray:
    """Return so many numbers of an attribute."""
    values = np.array(row(given, key, default))
    if len(values) != count:
        raise ValueError(f"the MJCF has {key}={given.get(key, '')!r:.60}, expected {count} numbers")
    return values


def number(given: Mapping[str, str], key: str, default: str = "") -> float:
    """Return the number of an attribute."""
    return float(numbers(given, key, 1, default)[0])


def _unit(vector: FloatArray, noun: str) -> FloatArray:
    """Return a direction as a vector of length 1."""
    length = float(np.linalg.norm(vector))
    if not length:
        raise ValueError(f"the MJCF has {noun} of length 0, expected a direction")
    return np.asarray(vector / length)


def _root(source: object) -> Element:
    """Return the parsed text of a file, or of the text itself."""
    if isinstance(source, str) and source.lstrip().startswith("<"):
        text, where = source, "source"
    else:
        path: Path = validation.file_path("source", source)
        text, where = read_text(path, _MOST_BYTES), f"source, {path},"
    try:
        root = _Reader(where).read(text)
    except expat.ExpatError as error:
        raise ValueError(f"{where} is not XML: {error}") from None
    if root.tag != "mujoco":
        raise ValueError(f"{where} begins with <{root.tag:.60}>, expected <mujoco>: MJCF")
    return root


class _Reader:
    """Makes the elements of a text, within bounds. Text between them says nothing in MJCF."""

    def __init__(self, where: str) -> None:
        self._where, self._depth, self._count = where, 0, 0
        self._made = ElementTree.TreeBuilder()
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.StartDoctypeDeclHandler = self._refuse_declarations

    def read(self, text: str) -> Element:
        """Return the outermost element."""
        self._parser.Parse(text, True)
        return self._made.close()

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        self._count += 1
        for count, limit, noun in (
            (self._depth, _MOST_DEPTH, "levels of elements within elements"),
            (self._count, _MOST_ELEMENTS, "elements"),
            (len(attributes), _MOST_ATTRIBUTES, "attributes in an element"),
        ):
            if count > limit:
                line = self._parser.CurrentLineNumber
                raise ValueError(
                    f"{self._where} has more than {limit:,} {noun}, the most that are read: "
                    f"line {line}, <{tag:.60}>"
                )
        self._made.start(tag, attributes)

    def _end(self, tag: str) -> None:
        self._depth -= 1
        self._made.end(tag)

    def _refuse_declarations(
        self, name: str, system: str | None, public: str | None, has_declarations: int
    ) -> None:
        if has_declarations:
            raise ValueError(
                f"{self._where} declares entities or attributes in <!DOCTYPE {name:.60} [...]>, "
                "which no MJCF needs: leave it out"
            )
