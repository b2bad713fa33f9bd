"""VTK's XML files, which ParaView and PyVista read: a shape, or a run as a time series."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.files import write_file
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.structure.structure import Structure

# More files would fill a folder by mistake.
_MOST_FRAMES = 100_000


def to_vtk(source: Structure | Trajectory, path: object) -> list[Path]:
    """Write a structure, or a run as a time series, for ParaView, and return the paths.

    A structure becomes one file ``.vtp``: nodes, and a line for each bar and for each segment of a
    string. A run becomes a ``.pvd`` that lists its times, and beside it a ``.vtp`` each. Lines have
    ``kind`` (0 bars, 1 strings) and ``member``, the number of the bar or string; of a run also
    ``force_density``, γ in N/m, and ``tension``, N, of strings, and nodes have ``velocity``, m/s.

    Parameters
    ----------
    source : Structure or Trajectory
    path : str or path
        Ending in ``.vtp`` for a structure, in ``.pvd`` for a run.

    Returns
    -------
    list of pathlib.Path
        All files, the one to open first.

    Raises
    ------
    TypeError, ValueError
        If the source or the ending of the path is another.
    OSError
        If a file cannot be written.

    References
    ----------
    VTK file formats, https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html

    Examples
    --------
    >>> import pathlib, tempfile, tenscontrol as tc
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> [file.name for file in tc.exchange.to_vtk(tc.prism(), folder / "prism.vtp")]
    ['prism.vtp']
    """
    if isinstance(source, Structure):
        file = validation.file_path("path", path, [".vtp"])
        return [write_file(file, _poly_data(source, source.nodes))]
    if not isinstance(source, Trajectory):
        raise validation.wrong_kind("source", source, "Structure or Trajectory")
    file = validation.file_path("path", path, [".pvd"])
    count = len(source.time)
    if count > _MOST_FRAMES:
        raise ValueError(
            f"the run has {count} outputs, a file each, expected at most {_MOST_FRAMES}; give "
            "simulate a longer output_step"
        )
    digits = len(str(count - 1))
    collection = Element("VTKFile", type="Collection", version="0.1")
    listed = SubElement(collection, "Collection")
    files = []
    for k, time in enumerate(source.time.tolist()):
        frame = file.with_name(f"{file.stem}_{k:0{digits}d}.vtp")
        gamma = source.force_density[:, k]
        text = _poly_data(source.structure, source.nodes[..., k], source.velocities[..., k], gamma)
        files.append(write_file(frame, text, flush=False))
        SubElement(listed, "DataSet", timestep=repr(time), file=frame.name)
    return [write_file(file, _text(collection)), *files]


def _poly_data(
    structure: Structure, nodes: FloatArray, velocities: FloatArray | None = None,
    gamma: FloatArray | None = None,
) -> str:  # fmt: skip
    """Return the file of one shape."""
    bars, segments = structure.bars, structure.segments
    lines = np.vstack([bars, segments])
    root = Element("VTKFile", type="PolyData", version="0.1", byte_order="LittleEndian")
    piece = SubElement(
        SubElement(root, "PolyData"), "Piece", NumberOfPoints=str(nodes.shape[1]),
        NumberOfLines=str(len(lines)),
    )  # fmt: skip
    _array(SubElement(piece, "Points"), "nodes", _in_space(nodes))
    if velocities is not None:
        _array(SubElement(piece, "PointData"), "velocity", _in_space(velocities))
    cells = SubElement(piece, "CellData")
    still = np.zeros(len(bars), np.int64)
    _array(cells, "kind", np.r_[still, np.ones(len(segments), np.int64)])
    _array(cells, "member", np.r_[np.arange(len(bars)), structure.segment_string])
    if gamma is not None:
        # A clustered string has one tension: that of its whole length.
        tension = gamma * structure.string_length(nodes)
        own = np.linalg.norm(structure.string_vectors(nodes), axis=0)
        pull = tension[structure.segment_string]
        density = np.divide(pull, own, out=np.zeros_like(pull), where=own > 0)
        _array(cells, "force_density", np.r_[still, density])
        _array(cells, "tension", np.r_[still, pull])
    where = SubElement(piece, "Lines")
    _array(where, "connectivity", lines.ravel())
    _array(where, "offsets", 2 * np.arange(1, len(lines) + 1))
    return _text(root)


def _in_space(columns: FloatArray) -> FloatArray:
    """Return rows of three, the third 0 in the plane."""
    return np.pad(columns, [(0, 3 - len(columns)), (0, 0)]).T


def _array(parent: Element, name: str, values: FloatArray | IntArray) -> None:
    kind = "Int64" if values.dtype == np.int64 else "Float64"
    width = {} if values.ndim == 1 else {"NumberOfComponents": str(values.shape[1])}
    entries: Sequence[object] = values.ravel().tolist()
    data = SubElement(parent, "DataArray", {"type": kind, "Name": name, "format": "ascii"} | width)
    data.text = " ".join(map(repr, entries))


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
