"""From commands to actuators: rest lengths and winches."""

from tenscontrol.actuation.rest_length import RestLengths, to_force_density, to_rest_length
from tenscontrol.actuation.winches import Winches, WinchMove

__all__ = ["RestLengths", "WinchMove", "Winches", "to_force_density", "to_rest_length"]
