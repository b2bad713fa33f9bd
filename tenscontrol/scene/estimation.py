"""Sensors and estimator of a scene."""

from __future__ import annotations

from tenscontrol.actuation import Winches
from tenscontrol.dynamics import Model
from tenscontrol.estimation import KalmanFilter, Sensors, kalman
from tenscontrol.plant import linearize
from tenscontrol.scene.document import Document
from tenscontrol.statics import Prestress
from tenscontrol.validation import whole_number


def build_estimator(
    document: Document,
    model: Model,
    rest: Prestress,
    input: str,
    step: float,
    winches: Winches | None,
) -> KalmanFilter | None:
    """Return the Kalman filter, designed on what the actuators hold, or None.

    Parameters
    ----------
    document : Document
    model : Model
        Of the whole strings.
    rest : Prestress
        About which it is designed.
    input : {"force_density", "rest_length"}
    step : float
        Sample time, s.
    winches : Winches, optional
        Of the whole strings: the prediction winds as they do.

    Returns
    -------
    KalmanFilter, or None if the scene has none
    """
    sensors, estimator = document.table("sensors"), document.table("estimator")
    for name, other in (("sensors", "estimator"), ("estimator", "sensors")):
        if document.has(name) and not document.has(other):
            raise document.error((name,), f"[{name}] goes with a table [{other}]")
    if not document.has("estimator"):
        return None
    estimator.choice("kind", ("kalman",))
    given = {key: value for key, value in sensors.values.items() if key != "seed"}
    with sensors.checked():
        whole_number("seed", sensors.get("seed", 0), least=0)
        readings = Sensors(structure=model.structure, **given)
    given = {key: value for key, value in estimator.values.items() if key != "kind"}
    with estimator.checked():
        plant = linearize(model, rest, input=input)
        return kalman(plant, readings, sample_time=step, winches=winches, **given)
