"""Squared errors of filters over their covariance, with each kind of sensor.

``python -m tests.benchmarks.filter_consistency [--runs 50]`` prints, for each kind, the mean of
``eᵀ P⁻¹ e`` by degree of freedom, and the bounds within which it is in 99.9 % of all cases.

States follow the equations of motion that the filter predicts by, from a start and with
disturbances as large as it supposes. What a filter leaves alone does not count.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

import tenscontrol as tc
from tests.benchmarks.command_line import options
from tests.benchmarks.filter_code import plant_of

STEP = 0.02
ANCHORS = np.array([[0.0, 4.0, 0.0, -2.0], [0.0, 4.0, -3.0, 2.0], [5.0, 5.0, 0.0, 2.0]])
COMPASS = {"bar_direction": 0.01}
KINDS = {
    "bar_inclination": COMPASS | {"bar_inclination": 0.01},
    "gyroscope": COMPASS | {"gyroscope": 0.02, "bias": {"gyroscope": (0.05, 0.01)}},
    "accelerometer": COMPASS | {"accelerometer": 0.1, "bias": {"accelerometer": (0.2, 0.05)}},
    "node_range": COMPASS | {"node_range": 0.02, "range_nodes": [0, 3, 5], "anchors": ANCHORS},
    "encoder": COMPASS
    | {"encoder": 0.2, "motor": tc.Motor(drum_radius=0.01, gear_ratio=20.0, zero=1.0)},
    "no compass": {"bar_inclination": 0.01, "gyroscope": 0.02},
    "no compass, biased": {
        "bar_inclination": 0.01, "gyroscope": 0.02, "bias": {"gyroscope": (0.05, 0.01)}
    },
}  # fmt: skip


@dataclass(frozen=True)
class Consistency:
    """Normalized squared error by degree of freedom, its bounds, and what was left alone."""

    error: float
    low: float
    high: float
    left_alone: int

    @property
    def is_within(self):
        return self.low < self.error < self.high


def filter_of(plant, kind, scale=1.0, prediction="linear"):
    """Return a filter with lengths and a kind of sensors, all noise times ``scale``."""
    arguments = {"string_length": 1e-3} | KINDS[kind]
    arguments = {
        name: scale * value if isinstance(value, float) else value
        for name, value in arguments.items()
    }
    if "bias" in arguments:
        arguments["bias"] = {
            name: tuple(scale * size for size in pair) for name, pair in arguments["bias"].items()
        }
    sensors = tc.Sensors(structure=plant.model.structure, **arguments)
    error = (1e-3 * scale, 1e-3 * scale) if kind == "encoder" else None
    return tc.KalmanFilter(
        plant, sensors, sample_time=STEP, process_noise=0.02 * scale, gate=1e-12,
        rest_length_error=error, prediction=prediction,
    )  # fmt: skip


def root(matrix):
    values, vectors = np.linalg.eigh(matrix)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def consistency(estimator, runs, samples=25, seed=2):
    """Return the consistency of a filter that starts from its steady covariance."""
    design, held = estimator._design, estimator.plant.rest_length
    lost = design.unseen
    seen = np.linalg.qr(lost, mode="complete")[0][:, lost.shape[1] :]
    unsteady = 1e-6 * lost @ lost.T  # there is no steady covariance of what is left alone
    P = estimator.covariance + unsteady
    drive, start = root(design.process_covariance), root(P)
    transition, noise = design.sampled.transition, estimator.sensors.noise
    rng, total, freedom = np.random.default_rng(seed), 0.0, 0
    for _ in range(runs):
        estimator.reset(covariance=P, held=held)
        z = start @ rng.normal(size=len(P))
        for _ in range(samples):
            y = np.array(design.outputs(z, held)[0]).ravel()
            estimate = estimator.update(y + noise * rng.normal(size=len(y)))
            off = estimate.state - z
            estimator.predict(held)
            z = transition @ z if design.motion is None else np.array(design.motion(z, held)[0])
            z = z.ravel() + drive @ rng.normal(size=len(z))
        off, covariance = seen.T @ off, seen.T @ estimate.covariance @ seen
        size = np.sqrt(np.diag(covariance))
        values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
        known = values > 1e-9  # a constraint between states leaves no error along it
        total += ((vectors.T @ (off / size))[known] ** 2 / values[known]).sum()
        freedom += int(known.sum())
    low, high = (chdtri(float(freedom), p) / freedom for p in (0.9995, 0.0005))
    return Consistency(total / freedom, low, high, lost.shape[1])


def main(arguments=None):
    runs = options(__doc__, arguments, runs=50).runs
    plant = plant_of()
    print("sensors               prediction  error  bounds        left alone")
    for kind in KINDS:
        for prediction, scale in (("linear", 1e-3), ("nonlinear", 0.3)):
            each = consistency(filter_of(plant, kind, scale, prediction), runs)
            print(
                f"{kind:20}  {prediction:10}  {each.error:5.3f}  {each.low:.3f}, {each.high:.3f}"
                f"  {each.left_alone:10d}{'' if each.is_within else '  outside'}"
            )


if __name__ == "__main__":
    main()
