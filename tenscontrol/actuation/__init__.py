"""From commands to actuators: rest lengths, winches and motors."""

from tenscontrol.actuation.motors import Motor, MotorRecord
from tenscontrol.actuation.winches import (
    RestLengths,
    Winches,
    WinchMove,
    to_force_density,
    to_rest_length,
)

__all__ = [
    "Motor",
    "MotorRecord",
    "RestLengths",
    "WinchMove",
    "Winches",
    "to_force_density",
    "to_rest_length",
]
