"""String laws and sensors with their parameters multiplied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np

from tenscontrol.dynamics import StringLaw
from tenscontrol.estimation import KINDS, Sensors
from tenscontrol.robustness.errors import SweepError
from tenscontrol.validation import float_array, per_member, positive_number


def varied_strings(
    strings: StringLaw | None, name: str, of_law: tuple[str, ...], factor: object, count: int
) -> StringLaw:
    """Return the law with a parameter multiplied: the first of these that it has."""
    found = [] if strings is None else [each.name for each in fields(strings)]
    scaled = [each for each in of_law if each in found]
    if strings is None or not scaled:
        raise SweepError(f"{name} is drawn, but the strings have none: {strings!r}")
    value = per_member(name, factor, count, "string")
    return replace(strings, **{scaled[0]: value * getattr(strings, scaled[0])})


def varied_sensors(sensors: Sensors | None, parameters: Mapping[str, object]) -> Sensors | None:
    """Return the sensors with the noise and delay that are drawn."""
    drawn = [name for name in ("noise", "delay") if name in parameters]
    if sensors is None:
        if drawn:
            raise SweepError(f"{drawn[0]} is drawn, but nothing is measured: give estimator")
        return None
    if "noise" in parameters:
        factor = positive_number("noise", parameters["noise"], "of the nominal deviations")
        kinds = [kind for kind, *_ in KINDS if getattr(sensors, kind) is not None]
        deviations = {kind: factor * getattr(sensors, kind) for kind in kinds}
        sensors = replace(sensors, **deviations)
    if "delay" in parameters:
        late = float_array("delay", parameters["delay"])
        if late.ndim or late < 0 or late != np.round(late):
            raise SweepError(
                f"delay is {parameters['delay']!r}, expected whole samples, at least 0: draw "
                "it by OneOf([0, 1, 2]), for example"
            )
        sensors = replace(sensors, delay=int(late))
    return sensors
