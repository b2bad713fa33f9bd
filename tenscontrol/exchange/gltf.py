"""glTF 2.0, which browsers, Blender and viewers show: a shape, or a run as an animation."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol.exchange.kinematic_tree import in_space
from tenscontrol.files import write_file
from tenscontrol.simulation import Trajectory
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, file_path, positive_number, wrong_kind

_SIDES = 12  # of the cylinders

# Colours that differ in grey print too; strings are a third as thick as bars.
_BAR_COLOUR, _STRING_COLOUR = (0.15, 0.15, 0.17, 1.0), (0.9, 0.35, 0.1, 1.0)
_THIN = 1 / 3

_FLOAT, _SHORT = 5126, 5123
_KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def to_gltf(source: Structure | Trajectory, path: object, bar_radius: float | None = None) -> Path:
    """Write a structure, or a run as an animation, as a binary glTF file, and return its path.

    Bars are thick and dark cylinders, strings thin and orange ones; each is a node with its name,
    ``bar0`` or ``string0``, a clustered string one a segment. Of a run, the animation has a key at
    each output, between which members move straight. Up, z here and y in the plane, is up there.

    Parameters
    ----------
    source : Structure or Trajectory
    path : str or path
        Ending in ``.glb``.
    bar_radius : float, optional
        m; a hundredth of the size if not given.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.
    OSError
        If the file cannot be written.

    References
    ----------
    Khronos Group, glTF 2.0 specification, https://registry.khronos.org/glTF/specs/2.0/

    Examples
    --------
    >>> import pathlib, tempfile, tenscontrol as tc
    >>> file = tc.exchange.to_gltf(tc.prism(), pathlib.Path(tempfile.mkdtemp()) / "prism.glb")
    >>> file.read_bytes()[:4]
    b'glTF'
    """
    place = file_path("path", path, [".glb"])
    if isinstance(source, Structure):
        structure, times, shapes = source, None, source.nodes[..., None]
    elif isinstance(source, Trajectory):
        structure, times, shapes = source.structure, source.time, source.nodes
    else:
        raise wrong_kind("source", source, "Structure or Trajectory")
    size = float(np.ptp(structure.nodes, axis=1).max())
    radius = 0.01 * size if bar_radius is None else positive_number("bar_radius", bar_radius, "m")
    file = _Binary()
    meshes = [_mesh(file, "bar", 0), _mesh(file, "string", 1)]
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "tenscontrol"},
        "scene": 0,
        "meshes": meshes,
        "materials": [_material("bar", _BAR_COLOUR), _material("string", _STRING_COLOUR)],
    }
    pairs = np.vstack([structure.bars, structure.segments])
    strings = structure.segment_string.tolist()
    names = [f"bar{i}" for i in range(len(structure.bars))] + [f"string{i}" for i in strings]
    keys = None if times is None or len(times) < 2 else file.add(_increasing(times), limits=True)
    nodes, channels, samplers = [], [], []
    for name, (start, end) in zip(names, pairs.tolist(), strict=True):
        is_bar = name.startswith("bar")
        width = radius if is_bar else _THIN * radius
        poses = _poses(shapes[:, start], shapes[:, end], width)
        nodes.append(
            {"name": name, "mesh": 0 if is_bar else 1}
            | {what: values[0].tolist() for what, values in poses.items()}
        )
        for what, values in poses.items() if keys is not None else ():
            samplers.append({"input": keys, "output": file.add(values)})
            target = {"node": len(nodes) - 1, "path": what}
            channels.append({"sampler": len(samplers) - 1, "target": target})
    document |= {"nodes": nodes, "scenes": [{"nodes": list(range(len(nodes)))}]}
    if channels:
        document["animations"] = [{"name": "run", "channels": channels, "samplers": samplers}]
    return write_file(place, file.packed(document))


def _increasing(times: FloatArray) -> FloatArray:
    """Return times from 0 in single precision, which must grow."""
    seconds = (times - times[0]).astype(np.float32)
    if (np.diff(seconds) <= 0).any():
        raise ValueError("source has outputs closer than single precision tells: give fewer")
    return np.asarray(seconds, dtype=float)


def _poses(start: FloatArray, end: FloatArray, width: float) -> dict[str, FloatArray]:
    """Return translation, rotation and scale of a cylinder along y from one node to another."""
    start, end = _turned_up(in_space(start)), _turned_up(in_space(end))
    arm = end - start
    length = np.linalg.norm(arm, axis=0)
    along = np.divide(arm, length, out=np.tile([[0.0], [1.0], [0.0]], arm.shape[1]),
                      where=length > 0)  # fmt: skip
    # From y to the arm by the shortest turn: about y × arm, by a quaternion x y z w.
    turn = np.vstack([along[2], 0 * length, -along[0], 1 + along[1]])
    back = np.linalg.norm(turn, axis=0) < 1e-6  # straight down: half a turn about x
    turn[:, back] = np.array([[1.0], [0.0], [0.0], [0.0]])
    turn /= np.linalg.norm(turn, axis=0)
    sign = np.cumprod(np.r_[1.0, np.where((turn[:, 1:] * turn[:, :-1]).sum(axis=0) < 0, -1, 1)])
    wide = np.full_like(length, width)
    return {
        "translation": ((start + end) / 2).T,
        "rotation": (sign * turn).T,
        "scale": np.vstack([wide, length, wide]).T,
    }


def _turned_up(columns: FloatArray) -> FloatArray:
    """Return columns with y up, as in glTF, of those with z up."""
    return np.vstack([columns[0], columns[2], -columns[1]])


def _material(name: str, colour: tuple[float, ...]) -> dict[str, Any]:
    rough = {"baseColorFactor": list(colour), "metallicFactor": 0.0, "roughnessFactor": 0.7}
    return {"name": name, "pbrMetallicRoughness": rough}


def _mesh(file: _Binary, name: str, material: int) -> dict[str, Any]:
    """Return a cylinder of radius and length 1 about y, with its caps."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.column_stack([np.cos(angle), 0 * angle, np.sin(angle)])
    low, high = (ring + np.array([0.0, side, 0.0]) for side in (-0.5, 0.5))
    flat = np.tile([0.0, 1.0, 0.0], (_SIDES, 1))
    places, normals = np.vstack([low, high, low, high]), np.vstack([ring, ring, -flat, flat])
    here, after = np.arange(_SIDES), (np.arange(_SIDES) + 1) % _SIDES
    sides = [here, here + _SIDES, after, after, here + _SIDES, after + _SIDES]
    fan = np.arange(1, _SIDES - 1)
    caps = np.concatenate([
        np.column_stack([0 * fan, fan, fan + 1]) + 2 * _SIDES,
        np.column_stack([0 * fan, fan + 1, fan]) + 3 * _SIDES,
    ])  # fmt: skip
    indices = np.concatenate([np.column_stack(sides).reshape(-1, 3), caps])
    attributes = {"POSITION": file.add(places, limits=True), "NORMAL": file.add(normals)}
    primitive = {
        "attributes": attributes, "indices": file.add(indices.ravel(), _SHORT),
        "material": material,
    }  # fmt: skip
    return {"name": name, "primitives": [primitive]}


class _Binary:
    """Arrays one after another, with what tells where each is."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._accessors: list[dict[str, Any]] = []
        self._views: list[dict[str, int]] = []

    def add(self, values: Any, kind: int = _FLOAT, limits: bool = False) -> int:
        """Add an array, shape (k,) or (k, 3 or 4), and return its number."""
        array = np.asarray(values, dtype="<f4" if kind == _FLOAT else "<u2")
        width = 1 if array.ndim == 1 else array.shape[1]
        accessor = {
            "bufferView": len(self._views), "componentType": kind, "count": len(array),
            "type": _KINDS[width],
        }  # fmt: skip
        if limits:
            accessor["min"] = np.atleast_1d(array.min(axis=0)).astype(float).tolist()
            accessor["max"] = np.atleast_1d(array.max(axis=0)).astype(float).tolist()
        size = array.nbytes
        self._views.append({"buffer": 0, "byteOffset": len(self._data), "byteLength": size})
        self._data += array.tobytes() + bytes(-size % 4)
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def packed(self, document: dict[str, Any]) -> bytes:
        """Return the whole file."""
        document |= {
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._data)}],
        }
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        parts = [(b"JSON", text), (b"BIN\0", bytes(self._data))]
        body = b"".join(struct.pack("<I", len(part)) + kind + part for kind, part in parts)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
