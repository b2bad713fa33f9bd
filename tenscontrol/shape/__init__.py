"""Shapes for control: equilibrium shapes that meet demands, and paths between them."""

from tenscontrol.shape.demands import Demand, Height, NodesAt, PointAt, Twist
from tenscontrol.shape.equilibrium_path import PathError
from tenscontrol.shape.rolling import RollingGait, RollingStep
from tenscontrol.shape.shape_path import ShapePath, shape_path
from tenscontrol.shape.strut_path import strut_path
from tenscontrol.shape.symmetry import RotationalSymmetry
from tenscontrol.shape.target import DemandCheck, ShapeError, ShapeTarget, shape_target
from tenscontrol.shape.tipping import TippingError, TippingPath, tipping_path

__all__ = [
    "Demand",
    "DemandCheck",
    "Height",
    "NodesAt",
    "PathError",
    "PointAt",
    "RollingGait",
    "RollingStep",
    "RotationalSymmetry",
    "ShapeError",
    "ShapePath",
    "ShapeTarget",
    "TippingError",
    "TippingPath",
    "Twist",
    "shape_path",
    "shape_target",
    "strut_path",
    "tipping_path",
]
