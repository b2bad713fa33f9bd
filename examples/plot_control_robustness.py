"""
How robust is a controller?
===========================

An MPC and a Kalman filter are designed for a nominal prism. The prism that they control differs:
each bar is up to 20 % heavier or lighter, each string up to 30 % stiffer or softer. The start is
disturbed, sensors have half or twice the nominal noise, and readings come up to 40 ms too early or
too late. How often does the prism end within 2 cm of its shape?
"""

import numpy as np

import tenscontrol as tc

TOLERANCE = 0.02  # m

prism, strings = tc.prism(), tc.LinearStrings(100.0, damping=0.5)

# %%
# The MPC commands rest lengths. A string that is softer than it should be pulls less at the
# rest length that is meant to balance it, which acts like a constant load. The
# MPC makes up for a load that it sees. But the filter, too, believes in the nominal
# strings: where it does not see the prism move as they would, it takes that for
# noise, and its estimate is off for good. With ``load=True`` it estimates the load as well.


def estimators(plant):
    """Return a filter that does not know of loads, and one that does."""
    sensors = tc.Sensors(structure=prism, string_length=0.001, bar_direction=0.005, delay=1)
    return {
        name: tc.KalmanFilter(plant, sensors, sample_time=0.04, process_noise=0.2, load=load)
        for name, load in (("no load estimated", False), ("load estimated", True))
    }


# %%
# ``ClosedLoopCase`` gives the plant what is drawn, and leaves controller and filter as they
# were designed. A sweep starts processes, and these read this file again, under
# another name: they must not start a sweep in turn. So few runs take some seconds;
# ``python -m tests.benchmarks.robustness`` does 200 of each.

drawn = {
    "stiffness": tc.Uniform(0.7, 1.3, size=9),
    "bar_mass": tc.Uniform(0.8, 1.2, size=3),
    "start": tc.Normal(0.0, 0.005, size=9),
    "noise": tc.Uniform(0.5, 2.0),
    "delay": tc.OneOf([0, 1, 2]),  # samples; the filter believes 1
}
counts = {"no load estimated": 10, "load estimated": 20}
reports = {}
if __name__ != "__mp_main__":
    rest = tc.prestress(prism, force_density=17.320508)  # N/m, top strings; 30 vertical
    plant = tc.linearize(tc.Model(prism, strings=strings), rest, input="rest_length")
    mpc = tc.MPC(plant, horizon=8, sample_time=0.04, max_force_density=65.0, load_gain=0.1)
    for name, estimator in estimators(plant).items():
        scene = tc.Scene(
            tc.Model(prism, strings=strings),
            duration=2.0,
            controller=mpc,
            estimator=estimator,
            integration=tc.Integration(step=1e-2),
        )
        case = tc.ClosedLoopCase(scene, tolerance=TOLERANCE)
        reports[name] = tc.sweep(case, drawn, counts[name], seed=0)
        print(f"{name}: {reports[name].summary()}\n")

# %%
# Left: the runs over the two numbers that go with the error most. Those of ``start`` are
# coordinates of the plant, in m √kg; stiffness, mass and noise are factors. Right: the part
# of the runs that ends up within a distance. The interval says how well so many runs
# tell the rate.

# sphinx_gallery_thumbnail_number = 3
for name, report in reports.items():
    figure = tc.plot.sweep(report, "final_error", unit="m", limit=TOLERANCE).axes[0].figure
    figure.suptitle(f"{name}, {len(report)} runs")

# %%
# Starts of the sweep, over the shape that they should come back to.

if reports:
    rng = np.random.default_rng(0)
    drawing = tc.plot.structure(prism)
    for _ in range(6):
        start = plant.to_nodes(rng.normal(0.0, 0.005, 9))
        tc.plot.structure(prism, start, ax=drawing.ax, faint=True)

if __name__ == "__main__":
    import matplotlib.pyplot as plt

    plt.show()
