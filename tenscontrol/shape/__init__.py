"""Shapes as a control engineer needs them: targets in equilibrium and paths between them."""

from tenscontrol.shape.constraints import Demand, NodesAt, PointAt
from tenscontrol.shape.measures import Height, Twist
from tenscontrol.shape.path import ShapePath, shape_path
from tenscontrol.shape.symmetry import RotationalSymmetry
from tenscontrol.shape.target import DemandCheck, ShapeError, ShapeTarget, shape_target
from tenscontrol.shape.timed import PathError

__all__ = [
    "Demand",
    "DemandCheck",
    "Height",
    "NodesAt",
    "PathError",
    "PointAt",
    "RotationalSymmetry",
    "ShapeError",
    "ShapePath",
    "ShapeTarget",
    "Twist",
    "shape_path",
    "shape_target",
]
