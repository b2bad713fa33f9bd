"""Structures and runs that go to and come from other programs."""

from tenscontrol.exchange.imported import Imported
from tenscontrol.exchange.mjcf_export import to_mujoco
from tenscontrol.exchange.mjcf_import import from_mujoco

__all__ = ["Imported", "from_mujoco", "to_mujoco"]
