"""URDF, the robot format of ROS: bars as links that float."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from tenscontrol.exchange.kinematic_tree import in_space
from tenscontrol.files import write_file
from tenscontrol.structure import Structure
from tenscontrol.validation import FloatArray, file_path, instance, positive_number


def to_urdf(structure: Structure, path: object, bar_radius: float | None = None) -> Path:
    """Write the bars of a structure as a URDF file, and return its path.

    URDF is a tree of links, with neither tendons nor closed loops nor ball joints. So bars are
    links that float in ``world``, with the mass and inertia of thin bars and cylinders to see and
    to touch; string nodes are small balls; strings are left out. It is of use to show a structure
    beside a robot, or to load its bodies into a simulator that is told the strings otherwise.
    :func:`to_mujoco` keeps all.

    Parameters
    ----------
    structure : Structure
        Of class 1, without bars that swing about a support, and without rollers.
    path : str or path
        Ending in ``.urdf``.
    bar_radius : float, optional
        Of the cylinders, m; a hundredth of the size if not given.

    Raises
    ------
    TypeError, ValueError
        If bars share nodes or swing, which URDF has no joint for, or an argument does not fit.
    OSError
        If the file cannot be written.

    References
    ----------
    http://wiki.ros.org/urdf/XML

    Examples
    --------
    >>> import pathlib, tempfile, tenscontrol as tc
    >>> ball = tc.library.six_bar_ball()
    >>> file = tc.exchange.to_urdf(ball, pathlib.Path(tempfile.mkdtemp()) / "ball.urdf")
    >>> file.read_text().count('type="floating"')
    6
    """
    instance("structure", structure, Structure, "make one by Structure(...)")
    place = file_path("path", path, [".urdf"])
    held = np.isin(structure.bars, structure.fixed)
    if structure.structure_class > 1:
        raise ValueError(
            f"structure is of class {structure.structure_class}: bars share nodes, and URDF has no "
            "ball joints and no loops; use to_mujoco"
        )
    if structure.rollers or (held.any(axis=1) != held.all(axis=1)).any():
        raise ValueError(
            "structure has bars that swing about a fixed node, or rollers: URDF has no ball "
            "joints; use to_mujoco"
        )
    size = float(np.ptp(structure.nodes, axis=1).max())
    radius = 0.01 * size if bar_radius is None else positive_number("bar_radius", bar_radius, "m")
    N = in_space(structure.nodes)
    robot = Element("robot", name="tensegrity")
    SubElement(robot, "link", name="world")
    for bar, (start, end) in enumerate(structure.bars.tolist()):
        arm, mass = N[:, end] - N[:, start], float(structure.bar_mass[bar])
        across = mass * float(arm @ arm) / 12
        # About its axis a thin bar has no inertia, which simulators do not take.
        along = 0.5 * mass * radius**2
        shape = SubElement(Element("geometry"), "cylinder", radius=repr(radius),
                           length=repr(float(np.linalg.norm(arm))))  # fmt: skip
        _link(robot, f"bar{bar}", mass, (across, across, along), shape)
        middle = 0.5 * (N[:, start] + N[:, end])
        _joint(robot, f"bar{bar}", "fixed" if held[bar].all() else "floating", middle, arm)
    for node in structure.string_nodes.tolist():
        mass = float(structure.point_mass[node])
        shape = SubElement(Element("geometry"), "sphere", radius=repr(radius))
        _link(robot, f"node{node}", mass, (0.4 * mass * radius**2,) * 3, shape)
        _joint(robot, f"node{node}", "floating", N[:, node], np.array([0.0, 0.0, 1.0]))
    ElementTree.indent(robot)
    text = ElementTree.tostring(robot, encoding="unicode")
    return write_file(place, f'<?xml version="1.0"?>\n{text}\n')


def _link(
    robot: Element, name: str, mass: float, moments: tuple[float, float, float], shape: Element
) -> None:
    link = SubElement(robot, "link", name=name)
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "mass", value=repr(mass))
    ixx, iyy, izz = map(repr, moments)
    SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")
    for use in ("visual", "collision"):
        SubElement(SubElement(link, use), "geometry").append(shape)


def _joint(robot: Element, link: str, kind: str, origin: FloatArray, axis: FloatArray) -> None:
    """Add the joint to the world of a link whose z is along an axis."""
    x, y, z = axis / np.linalg.norm(axis)
    joint = SubElement(robot, "joint", name=f"{link}_to_world", type=kind)
    SubElement(joint, "parent", link="world")
    SubElement(joint, "child", link=link)
    # Roll, pitch and yaw about fixed axes: none, down to the axis, and around z.
    angles = 0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x))
    SubElement(joint, "origin", xyz=_row(origin), rpy=_row(angles))


def _row(values: FloatArray | tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)
