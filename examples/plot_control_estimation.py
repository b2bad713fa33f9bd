"""
A Kalman filter in the loop
===========================

An LQR brings a prism to rest, but node positions are not measured. Sensors give the lengths of its
strings and the directions of its bars. Readings have noise and come two samples late. One sample in
ten is lost, and one reading in fifty is wrong. A Kalman filter estimates the motion from them.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

STEP = 0.02

prism = tc.prism()
model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
rest = tc.prestress(prism, force_density=17.320508)  # N/m in the top strings; 30 in the vertical
tc.plot.structure(prism, labels=True, member_labels=True)
plant = tc.linearize(model, rest)
Q, R = tc.energy_weights(plant)
regulator = tc.LQR(plant, Q, 0.1 * R, sample_time=STEP, max_force_density=90.0)

# %%
# The filter must know what acts between samples. The LQR commands force densities, but winches
# hold rest lengths: the filter is designed on that plant.

held = tc.linearize(model, rest, input="rest_length")

# %%
# Which readings do? To first order the mechanism of the prism changes no string's length. But as it
# vibrates it does, so that the lengths of all strings show every motion. A single string
# does not, and is refused with what to add.

try:
    tc.KalmanFilter(
        held, tc.Sensors(structure=prism, string_length=1e-3, strings=[0]), sample_time=STEP
    )
except ValueError as error:
    refusal = str(error)
    print(refusal)

choices = {
    "lengths": {"string_length": 1e-3},
    "directions": {"bar_direction": 1e-2},
    "lengths and directions": {"string_length": 1e-3, "bar_direction": 1e-2},
}
faults = {"delay": 2, "drop_rate": 0.1, "outlier_rate": 0.02}

# %%
# The same disturbed start with each, and with the motion itself as a measure.

start = plant.to_nodes(0.01 * np.random.default_rng(0).normal(size=9))
wound = tc.to_rest_length(model, start, rest.force_density).rest_length


def simulated(**options):
    """Return four seconds of the loop."""
    return tc.simulate(
        model, 4.0, start, controller=regulator, step=1e-3, rest_length=wound, **options
    )


def off_target(run):
    """Return how far the farthest node is from its place, rigid motion apart, m."""
    off = []
    for k in range(0, len(run.time), 20):
        z = held.measure(run.nodes[:, :, k], run.velocities[:, :, k])
        off.append(np.linalg.norm(held.to_nodes(z[:9]) - prism.nodes, axis=0).max())
    return np.array(off)


runs = {"motion seen": simulated()}
for name, noise in choices.items():
    sensors = tc.Sensors(structure=prism, **noise, **faults)
    runs[name] = simulated(estimator=tc.KalmanFilter(held, sensors, sample_time=STEP), seed=1)

curves = {name: off_target(run) for name, run in runs.items()}
left = {name: off[-50:].max() for name, off in curves.items()}
for name, off in left.items():
    print(f"{name:24s} farthest node in the last second {1e3 * off:6.2f} mm")

drawn = tc.plot.history(runs["motion seen"].time[::20], curves, "largest node error, m")
drawn.ax.set_yscale("log")

# %%
# What the filter made of lengths and directions. The band is what it expects of its own errors.

run = runs["lengths and directions"]
print(run.summary())
statistics = run.control.estimate.statistics
print(f"{statistics.refused.sum()} readings refused, {statistics.restarts} starts anew")
tc.plot.estimate(run, strings=(0, 6))

if __name__ == "__main__":
    plt.show()
