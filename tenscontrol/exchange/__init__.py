"""Structures and runs that go to and come from other programs, a file a format."""

from tenscontrol.exchange.csv_tables import from_csv
from tenscontrol.exchange.imported import Imported
from tenscontrol.exchange.mjcf_export import to_mujoco
from tenscontrol.exchange.mjcf_import import from_mujoco
from tenscontrol.exchange.vtk import to_vtk

__all__ = [
    "Imported",
    "from_csv",
    "from_mujoco",
    "to_mujoco",
    "to_vtk",
]
