"""From commands to actuators: rest lengths, winches and motors."""

from tenscontrol.actuation.motors import (
    EachMotor,
    Instants,
    Motor,
    MotorRecord,
    Turning,
    cable_work,
    each_motor,
    motor_record,
    winding_work,
)
from tenscontrol.actuation.winches import (
    Drive,
    RestLengths,
    Tick,
    Winches,
    WinchMove,
    to_force_density,
    to_rest_length,
)

__all__ = [
    "Drive",
    "EachMotor",
    "Instants",
    "Motor",
    "MotorRecord",
    "RestLengths",
    "Tick",
    "Turning",
    "WinchMove",
    "Winches",
    "cable_work",
    "each_motor",
    "motor_record",
    "to_force_density",
    "to_rest_length",
    "winding_work",
]
