"""Actuators of strings: driven strings, rest lengths, winches, motors."""

from tenscontrol.actuation.driven_strings import Actuation
from tenscontrol.actuation.motor_record import MotorRecord
from tenscontrol.actuation.motors import Motor
from tenscontrol.actuation.rest_lengths import RestLengths, to_force_density, to_rest_length
from tenscontrol.actuation.winches import Winches, WinchMove

__all__ = [
    "Actuation",
    "Motor",
    "MotorRecord",
    "RestLengths",
    "WinchMove",
    "Winches",
    "to_force_density",
    "to_rest_length",
]
