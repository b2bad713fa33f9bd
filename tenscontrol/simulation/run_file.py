"""Files of runs: NumPy archives with a header in JSON that says what each array is."""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import partial
from io import BufferedReader
from math import isfinite, prod
from pathlib import Path
from types import NoneType
from typing import Any, BinaryIO

import casadi as ca
import numpy as np

from tenscontrol import validation
from tenscontrol._version import __version__
from tenscontrol.actuation.driven_strings import Actuation
from tenscontrol.actuation.motor_record import MotorRecord
from tenscontrol.actuation.motors import Motor
from tenscontrol.actuation.winches import Winches
from tenscontrol.control.command import Fallback
from tenscontrol.control.feedback_linearization import FeedbackLinearizationStatistics
from tenscontrol.control.mpc.constraints import OutputLimit
from tenscontrol.control.mpc.linear import MPCStatistics
from tenscontrol.control.mpc.nonlinear import NMPCStatistics
from tenscontrol.dynamics.contact_laws import Ground, HertzGround, SmoothGround
from tenscontrol.dynamics.evaluator import Function
from tenscontrol.dynamics.instructions import OPERATIONS, instructions
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.profile import Profile
from tenscontrol.dynamics.string_laws import ElasticStrings, LinearStrings
from tenscontrol.estimation.kalman_filter import FilterStatistics
from tenscontrol.files import opened_file, write_file
from tenscontrol.integrate.integrator import MethodChange, Work
from tenscontrol.integrate.methods import Choice
from tenscontrol.parsing import parse_json
from tenscontrol.plant.reference import Reference
from tenscontrol.simulation.arguments import Arguments, Unsaved
from tenscontrol.simulation.contacts import ContactRecord
from tenscontrol.simulation.control_record import ControlRecord
from tenscontrol.simulation.faults import CutString, LostMeasurement, StuckWinch
from tenscontrol.simulation.observation import EstimateRecord
from tenscontrol.simulation.strut_record import StrutRecord
from tenscontrol.status import Status
from tenscontrol.structure.bar_clearance import BarClearance, BarCrossing
from tenscontrol.structure.structure import Structure

#: Version of the form; files of a later one are refused.
VERSION = 1
_FORMAT = "tenscontrol run"

#: What a run evaluates when it is first read, and a file or a pickle holds.
EVALUATED = (
    "force_density", "kinetic_energy", "potential_energy", "momentum", "angular_momentum",
    "bar_length_error",
)  # fmt: skip

#: What it finds out about its bars, likewise.
OF_BARS = ("bar_crossings", "bar_clearance", "unresolved_intervals")

# Nothing else is made from a file.
_RECORDS = {
    kind.__name__: kind
    for kind in (
        Actuation, BarClearance, BarCrossing, Choice, ContactRecord, ControlRecord, CutString,
        ElasticStrings, EstimateRecord, FeedbackLinearizationStatistics, FilterStatistics, Ground,
        HertzGround, LinearStrings, LostMeasurement, MethodChange, Motor, MotorRecord,
        MPCStatistics, NMPCStatistics, OutputLimit, Profile, Reference, SmoothGround, Structure,
        StrutRecord, StuckWinch, Winches, Work,
    )
}  # fmt: skip
_WORDS: dict[str, type[StrEnum]] = {"Status": Status, "Fallback": Fallback}

# The parts of a run; what is None or not there is so for a reason that the run says.
_ARRAY = np.ndarray
_PARTS: dict[str, type | tuple[type, ...]] = {
    "structure": Structure, "choice": Choice, "work": Work, "faults": tuple, "given": Arguments,
    "conserves_energy": bool, "conserves_momentum": bool, "falls": bool, "moved": bool,
    "stopped": (str, NoneType), "note": (str, NoneType), "error_limit": (float,),
    "control": (ControlRecord, NoneType), "contacts": (ContactRecord, NoneType),
    "struts": (StrutRecord, NoneType),
    "ground": (tuple, Unsaved), "model": (dict, Unsaved, NoneType), "load": (_ARRAY, NoneType),
    "error": (_ARRAY, NoneType),
    "rest_length": (_ARRAY, NoneType), "time": _ARRAY, "nodes": _ARRAY, "velocities": _ARRAY,
    "released_energy": _ARRAY, **dict.fromkeys(EVALUATED, _ARRAY),
    "bar_crossings": (tuple, NoneType), "bar_clearance": (BarClearance, NoneType),
    "unresolved_intervals": int,
}  # fmt: skip

# Arrays by the name of the attribute, with the letters of their dimensions: one letter, one length.
# Those of the structure come first: they say what the others must be.
_SHAPES = {
    "structure_nodes": "dn", "structure_bars": "b2", "structure_strings": "a2",
    "structure_bar_mass": "b", "structure_point_mass": "n", "structure_string_parent": "a",
    "time": "T", "nodes": "dnT", "velocities": "dnT", "rest_length": "aT", "released_energy": "T",
    "error": "T",
    "force_density": "aT", "kinetic_energy": "T", "potential_energy": "T", "momentum": "dT",
    "angular_momentum": "rT", "bar_length_error": "bT", "control_time": "K",
    "control_command": "wK", "control_applied": "wK", "control_status": "K",
    "control_fallback": "K", "control_winch_rate": "wK", "control_rate_limited": "K",
    "control_range_limited": "K", "control_computing_time": "K", "control_prediction_error": "K",
    "control_at_bound": "K", "control_estimate_time": "K", "control_estimate_nodes": "dmK",
    "control_estimate_velocities": "dmK", "control_estimate_node_deviation": "dmK",
    "control_estimate_length_deviation": "eK", "control_estimate_state": "xK",
    "control_estimate_bias": "yK", "control_estimate_bias_deviation": "yK",
    "control_estimate_actual_bias": "yK", "control_estimate_measurement": "yK",
    "control_estimate_status": "K",
    "control_motors_time": "T", "control_motors_angle": "iT",
    "control_motors_speed": "iT", "control_motors_torque": "iT", "control_motors_power": "iT",
    "control_motors_energy": "iT", "control_motors_torque_limited": "K",
    "control_motors_zero": "i", "control_motors_angle_command": "iK",
    "control_actuation_input": "w", "control_actuation_ratio": "w",
    "control_actuation_offset": "w", "control_actuation_lead": "i",
    "contacts_node": "c", "contacts_law": "c", "contacts_depth": "cT",
    "contacts_normal_force": "cT", "contacts_tangential_force": "dcT",
    "contacts_stored_energy": "cT", "contacts_damping_work": "cT", "contacts_friction_work": "cT",
    "contacts_impulse": "dcT", "contacts_deepest": "c", "contacts_touch": "k",
    "contacts_begin": "k", "contacts_end": "k",
    "struts_bar": "s", **dict.fromkeys(
        (
            f"struts_{name}"
            for name in ("length", "rate", "acceleration", "force", "work", "work_error")
        ), "bT",
    ),
}  # fmt: skip
# Of these, NaN says that there was none; deviations and estimates of errors may be infinite.
_MAY_BE_NAN = ("error", "control_prediction_error", "control_estimate_", "struts_work_error")
# Of a run that ended early the rest may have overflowed.
_MOTION = ("time", "nodes", "velocities", "rest_length")

# Where what a file cannot hold may be: the rest of the run does not depend on it.
_MAY_BE_UNSAVED = ("control.settings.", "given.", "ground.", "model")

# Kinds of arrays: truths, whole numbers, floats, text.
_NUMBERS = ("b1", "i4", "i8", "f8")
_KINDS = (*_NUMBERS, "U")
# Of a file, and of all its arrays: twice what simulate keeps of nodes and velocities.
_MOST_BYTES = 8_000_000_000
# Level of deflate, and how many entries of an array show whether it is worth the time.
_LEVEL, _SAMPLE = 1, 10_000
# Bytes that are read at once; the directory of an archive of 10,000 arrays is shorter.
_PIECE = 1_000_000

# What reading a damaged archive raises: its own errors, those of its parts, and what NumPy and the
# records say of values that do not fit.
_FAULTS = (
    ArithmeticError, AttributeError, EOFError, LookupError, NotImplementedError, OSError,
    RuntimeError, TypeError, ValueError, struct.error, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


# ---- writing ----


def write_run(path: object, values: Mapping[str, Any]) -> Path:
    """Write the parts of a run by name, arrays and records; see :meth:`Trajectory.save`."""
    file = validation.file_path("path", path, (".npz",))
    out = _Writer()
    run = {name: out.node(value, (name,)) for name, value in values.items()}
    for place, kind in out.unsaved.items():
        if not place.startswith(_MAY_BE_UNSAVED):
            raise TypeError(f"{place} of the run is {kind}, which no file of a run can hold")
    header = {
        "format": _FORMAT, "version": VERSION, "tenscontrol": __version__,
        "not_saved": out.unsaved, "run": run,
    }  # fmt: skip
    text = json.dumps(header, allow_nan=False).encode()
    arrays = out.arrays | {"header": np.frombuffer(text, dtype=np.uint8)}
    return write_file(file, partial(_write_archive, arrays))


def _write_archive(arrays: Mapping[str, np.ndarray], file: BinaryIO) -> None:
    with zipfile.ZipFile(file, "w", compresslevel=_LEVEL) as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")  # of no date: the same run, the same bytes
            if _repeats(array):
                member.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(member, "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, array, (1, 0), allow_pickle=False)


def _repeats(array: np.ndarray) -> bool:
    """Return whether numbers recur, as those of what rests: motions have no two digits alike."""
    start = max(0, array.size - _SAMPLE) // 2
    sample = array.flat[start : start + _SAMPLE].tobytes()
    return len(zlib.compress(sample, _LEVEL)) < len(sample) / 2


class _Writer:
    """Values as JSON, with the arrays that they hold beside it, by name."""

    def __init__(self) -> None:
        self.arrays: dict[str, np.ndarray] = {}
        self.unsaved: dict[str, str] = {}

    def node(self, value: Any, path: tuple[str, ...]) -> Any:
        """Return a value as JSON; ``path`` leads to it."""
        if isinstance(value, np.generic):
            value = value.item()
        if value is None or isinstance(value, bool | int | str):
            return str(value) if isinstance(value, str) else value
        if isinstance(value, float):
            return value if isfinite(value) else {"float": repr(value)}
        if isinstance(value, np.ndarray) and value.dtype.str[1:] in _NUMBERS:
            return self._array(value, path)
        if isinstance(value, tuple | list):
            words = {type(item) for item in value} - {type(None)}
            if len(words) == 1 and (kind := words.pop()) in _WORDS.values():
                array = np.array([str(item or "") for item in value])
                return {"words": kind.__name__, **self._array(array, path)}
            parts = [self.node(item, (*path, str(i))) for i, item in enumerate(value)]
            return {"tuple" if isinstance(value, tuple) else "list": parts}
        if isinstance(value, dict | Arguments):
            raw = value if isinstance(value, dict) else value.raw
            items = {str(key): self.node(item, (*path, str(key))) for key, item in raw.items()}
            if raw is not value:
                return {"given": items}
            of = next((type(key).__name__ for key in raw), "str")
            return {"dict": items} if of == "str" else {"dict": items, "keys": of}
        if isinstance(value, ca.Function) and (lines := _instructions(value)) is not None:
            names = [value.name(), *map(value.name_in, range(value.n_in()))]
            return {"function": names, "lines": self.node(lines, path)}
        if type(value) in _RECORDS.values():
            entries = {field.name: getattr(value, field.name) for field in fields(value)}
            if isinstance(value, OutputLimit):  # no bound is infinite in it, and None to make it
                entries |= {name: None for name in ("low", "high") if np.isinf(entries[name]).all()}
            inside = {name: self.node(item, (*path, name)) for name, item in entries.items()}
            return {"record": type(value).__name__, "fields": inside}
        left = value if isinstance(value, Unsaved) else Unsaved.of(".".join(path), value)
        self.unsaved[left.place] = left.what
        return {"unsaved": left.place, "what": left.what}

    def _array(self, value: np.ndarray, path: tuple[str, ...]) -> dict[str, str]:
        name = "_".join(path)
        while name in self.arrays:
            name += "_"
        self.arrays[name] = value
        return {"array": name}


def _instructions(function: ca.Function) -> list[list[Any]] | None:
    """Return the instructions of a function of numbers, by name; None where it calls others."""
    try:
        flat = function if function.is_a("SXFunction") else function.expand()
    except RuntimeError:  # it calls what has no expression
        return None
    lines = instructions(flat)
    return None if lines is None else [list(line) for line in lines]


# ---- reading ----


def read_run(path: object) -> dict[str, Any]:
    """Return the parts of a run by name, or raise a ValueError that names the file.

    Names, kinds, shapes and sizes of all arrays are checked before one is read. What no file can
    hold is :class:`Unsaved`. The model is None for a copy, which has none.
    """
    file = validation.file_path("path", path)
    with opened_file(file, _MOST_BYTES) as stream:
        pieces = _Pieces(stream.raw)
        try:
            if not zipfile.is_zipfile(pieces):
                raise _RefusedError("no run: expected a file that run.save(path) wrote")
            with zipfile.ZipFile(pieces) as archive:
                return _read_archive(archive)
        except _RefusedError as error:
            raise ValueError(f"{file}: {error}") from None
        except (*_FAULTS, MemoryError, RecursionError) as error:
            reason = str(error) or type(error).__name__
            raise ValueError(
                f"{file}: damaged, expected what run.save(path) wrote: {reason}"
            ) from error


class _RefusedError(ValueError):
    """A file that is whole, but no run for this release."""


class _Pieces(BufferedReader):
    """A file read in pieces, so that a directory as long as the file is not read at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        """Return at most so many bytes; all that are left if it is None or negative."""
        asked = _PIECE + 1 if size is None or size < 0 else min(size, _PIECE + 1)
        data = super().read(asked)
        if len(data) > _PIECE:
            raise _RefusedError(f"no run: its directory has more than {_PIECE:,} bytes")
        return data


@dataclass(frozen=True)
class _Form:
    """What the header of an array says: shape, kind of its entries, and their order."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    is_fortran: bool
    length: int  # of the header, bytes

    @staticmethod
    def of(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> _Form:
        """Return the form of an array, or refuse one that the archive holds in another size."""
        name = member.filename
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{name} is packed by another way than deflate")
        with archive.open(member) as stream:
            if np.lib.format.read_magic(stream) != (1, 0):
                raise ValueError(f"{name} is no array of the first form of NumPy")
            shape, is_fortran, dtype = np.lib.format.read_array_header_1_0(stream)
            length = stream.tell()
        kinds = ("u1",) if name == "header.npy" else _KINDS
        if not dtype.str[1:].startswith(kinds) or dtype.byteorder == ">" or not dtype.itemsize:
            raise TypeError(f"{name} has entries of the kind {dtype}")
        form = _Form(shape, dtype, is_fortran, length)
        if min(shape, default=0) < 0 or length + form.size != member.file_size:
            have = member.file_size - length
            raise ValueError(f"{name} has {have:,} bytes, expected an array of shape {shape}")
        return form

    @property
    def size(self) -> int:
        """Bytes of the entries."""
        return prod(self.shape) * self.dtype.itemsize


class _Arrays(Mapping[str, np.ndarray]):
    """The arrays of an archive by name. Only headers are read until an array is asked for."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._members = {
            member.filename.removesuffix(".npy"): member for member in archive.infolist()
        }
        if len(self._members) != len(archive.infolist()):
            raise ValueError("it has two arrays of one name")
        self.forms = {name: _Form.of(archive, member) for name, member in self._members.items()}
        # An array without entries counts too, by its other dimensions.
        taken = sum(
            prod(max(size, 1) for size in form.shape) * form.dtype.itemsize
            for form in self.forms.values()
        )
        if taken > _MOST_BYTES:
            raise _RefusedError(
                f"is too large: arrays of {taken:,} bytes, at most {_MOST_BYTES:,} are read"
            )

    def __iter__(self) -> Iterator[str]:
        return iter(self.forms)

    def __len__(self) -> int:
        return len(self.forms)

    def __getitem__(self, name: str) -> np.ndarray:
        """Return an array, read-only; its check sum is that of the archive."""
        form, member = self.forms[name], self._members[name]
        array = np.empty(form.shape, form.dtype, order="F" if form.is_fortran else "C")
        into, filled = array.ravel(order="K").view(np.uint8), 0
        with self._archive.open(member) as stream:
            stream.read(form.length)
            while piece := stream.read(_PIECE):
                into[filled : filled + len(piece)] = np.frombuffer(piece, np.uint8)
                filled += len(piece)
        if filled != form.size:
            raise ValueError(f"{member.filename} holds {filled:,} bytes, expected {form.size:,}")
        array.setflags(write=False)
        return array


def _read_archive(archive: zipfile.ZipFile) -> dict[str, Any]:
    if "header.npy" not in archive.NameToInfo:
        raise _RefusedError(
            "no run: the archive has no header. Files of releases before 0.2 have none; "
            "numpy.load(file) reads their arrays"
        )
    arrays = _Arrays(archive)
    header = parse_json("header", arrays["header"].tobytes().decode())
    if not isinstance(header, dict) or header.get("format") != _FORMAT:
        raise _RefusedError("no run: the header is not that of a run")
    version = header["version"]
    if version != VERSION:
        raise _RefusedError(
            f"version is {version!r:.20}, expected {VERSION}: the file was written by "
            f"tenscontrol {header.get('tenscontrol')!s:.20}; this is {__version__}. Read it "
            "with that release or a later one"
        )
    parts = header["run"]
    if not isinstance(parts, dict):
        raise TypeError(f"run is a {type(parts).__name__}, expected parts by name")
    unknown = sorted(parts.keys() - _PARTS.keys())
    if unknown:
        raise ValueError(f"{unknown[0]!r:.60} is not what a run has")
    _check_names(parts, arrays.forms.keys() - {"header"})
    _check_shapes({name: form.shape for name, form in arrays.forms.items()})
    reader = _Reader(arrays, is_complete=parts.get("stopped") is None)
    run = {name: reader.value(node, name) for name, node in parts.items()}
    for name, kind in _PARTS.items():
        if not isinstance(run.get(name, run), kind):
            raise TypeError(f"{name} is not what a run has there")
    if run["model"] is not None:
        run["model"] = _model(run["structure"], run["ground"], run["model"])
    return run


def _array_places(node: Any, place: str) -> Iterator[tuple[str, str]]:
    """Yield the name of each array that a node names, and its place."""
    if not isinstance(node, dict):
        return
    if isinstance(name := node.get("array"), str):
        yield name, place
    for key in ("fields", "dict", "given", "list", "tuple"):
        inside = node.get(key)
        items = inside.items() if isinstance(inside, dict) else enumerate(inside or ())
        for entry, value in items:
            yield from _array_places(value, f"{place}.{entry}")


def _check_names(parts: Mapping[str, Any], names: Set[str]) -> None:
    """Refuse arrays that are not called after their places, and those of no place or two."""
    left = set(names)
    for root, node in parts.items():
        for name, place in _array_places(node, root):
            # Where places would have one name, the later has underscores at its end.
            if name.replace(".", "_").rstrip("_") != place.replace(".", "_").rstrip("_"):
                raise ValueError(f"{place} is the array {name!r:.60}, expected one of its own name")
            if name not in left:
                raise ValueError(f"{place} is the array {name!r:.60}, which is not there")
            left.remove(name)
    if left:
        raise ValueError(f"it has an array that the header does not name: {min(left)}")


class _Reader:
    """Values from JSON and arrays. Of a complete run all must be finite, or say that it is not."""

    def __init__(self, arrays: Mapping[str, np.ndarray], is_complete: bool = True) -> None:
        self._arrays, self._is_complete = arrays, is_complete

    def value(self, node: Any, place: str) -> Any:
        """Return what a node says."""
        if not isinstance(node, dict):
            if isinstance(node, list):
                raise TypeError(f"{place} is a list, expected a value")
            return node
        match node:
            case {"unsaved": str(where), "what": str(what)}:
                return Unsaved(where, what)
            case {"float": "inf" | "-inf" | "nan" as text}:
                return float(text)
            case {"words": str(kind), "array": str(name)}:
                words = self._take(name, "U").tolist()
                return tuple(_WORDS[kind](word) if word else None for word in words)
            case {"array": str(name)}:
                return self._take(name, "bif")
            case {"function": [str(name), *names], "lines": lines}:
                return _function(name, names, self.value(lines, place))
        return self._container(node, place)

    def _container(self, node: dict[str, Any], place: str) -> Any:
        """Return what holds other values; what holds something unsaved is so itself."""
        match node:
            case {"given": dict(items)}:
                return Arguments(self._inside(items, place))
            case {"dict": dict(items), "keys": str(of)}:
                return {_WORDS[of](key): item for key, item in self._inside(items, place).items()}
            case {"dict": dict(items)}:
                return _whole(contents := self._inside(items, place), contents)
            case {"list": list(items)}:
                contents = self._inside(dict(enumerate(items)), place)
                return _whole(contents, list(contents.values()))
            case {"tuple": list(items)}:
                contents = self._inside(dict(enumerate(items)), place)
                return _whole(contents, tuple(contents.values()))
            case {"record": str(kind), "fields": dict(items)}:
                contents = self._inside(items, place)
                cut = next((item for item in contents.values() if isinstance(item, Unsaved)), None)
                return cut or _RECORDS[kind](**contents)
        raise ValueError(f"{place} is not understood")

    def _inside(self, items: dict[Any, Any], place: str) -> dict[Any, Any]:
        return {key: self.value(node, f"{place}.{key}") for key, node in items.items()}

    def _take(self, name: str, kinds: str) -> np.ndarray:
        array = self._arrays[name]
        if array.dtype.kind not in kinds:
            raise TypeError(f"{name} has entries of the kind {array.dtype}")
        every = self._is_complete and not name.startswith(_MAY_BE_NAN)
        checked = name in _MOTION or (every and name in _SHAPES)
        if checked and array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{name} holds what is not finite")
        return array


def _whole(contents: Mapping[Any, Any], container: Any) -> Any:
    """Return what was made of values, or the first of them that a file does not hold."""
    return next((item for item in contents.values() if isinstance(item, Unsaved)), container)


def _function(name: str, names: list[str], lines: list[list[Any]]) -> ca.Function:
    """Return a function of numbers from its instructions."""
    inputs = [ca.SX.sym(label) for label in names]
    work: dict[int, ca.SX] = {}
    result = ca.SX(1, 1)
    for code, into, of, constant in lines:
        if code not in OPERATIONS:
            raise ValueError(f"the function {name} has the instruction {code!r:.20}")
        if code == "OUTPUT":
            result = work[of[0]]
        elif code == "INPUT":
            work[into[0]] = inputs[of[0]]
        elif code == "CONST":
            work[into[0]] = ca.SX(constant)
        else:
            parts = [work[operand] for operand in of]
            make = ca.SX.unary if len(parts) == 1 else ca.SX.binary
            work[into[0]] = make(getattr(ca, f"OP_{code}"), *parts)
    return Function(name, inputs, [result], names, ["h"])


def _check_shapes(shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse shapes that do not fit those of the structure and each other."""
    size = {"2": 2}
    for name, letters in _SHAPES.items():
        if name not in shapes:
            continue
        shape = shapes[name]
        expected = tuple(size.get(letter, letter) for letter in letters)
        pairs = zip(expected, shape, strict=False)
        if len(letters) != len(shape) or any(a != b for a, b in pairs if isinstance(a, int)):
            text = str(expected).replace("'", "")
            raise ValueError(f"{name} has shape {shape}, expected {text}")
        size |= dict(zip(letters, shape, strict=True))
        if name == "structure_nodes":
            size["r"] = 3 if size["d"] == 3 else 1


# ---- the model, which has no fields ----


def model_parts(model: Model) -> dict[str, Any]:
    """Return what a model is made of, beside its structure."""
    return {k: v for k, v in model.arguments.items() if k not in ("structure", "ground")}


def _model(structure: Structure, ground: Any, parts: Any) -> Model | Unsaved:
    """Return the model of its parts, or what of it a file does not hold."""
    missing = [item for item in (ground, parts) if isinstance(item, Unsaved)]
    return missing[0] if missing else Model(structure, ground=ground, **parts)


# ---- for other programs ----
