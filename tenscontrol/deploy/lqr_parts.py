"""The linear-quadratic regulator as parts of C code."""

from __future__ import annotations

from tenscontrol.control import LQR
from tenscontrol.deploy.parts import Parts


def lqr_parts(controller: LQR) -> Parts:
    """Return the parts of a regulator with a sample time.

    Raises
    ------
    ValueError
        If it acts in continuous time.
    """
    if controller.sample_time is None:
        raise ValueError(
            "controller is an LQR in continuous time, and code runs in samples: "
            "make it by lqr(plant, Q, R, step=...)"
        )
    matrices = {"feedback": -controller.gain}
    if controller.previous_input_gain is not None:
        matrices["held_feedback"] = -controller.previous_input_gain
    ramp = int(controller.previous_input_gain is not None)
    return Parts(("lqr.c",), {"WINDS": ramp}, {}, matrices)
