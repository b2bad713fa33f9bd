"""
A ball with inertial sensors and encoders
=========================================

A ball of six bars has an inertial sensor on each bar, without a compass, and an encoder on each
winch. Nobody sees its nodes or the lengths of its strings. The gyroscopes have a bias. A Kalman
filter finds shape and bias while a regulator damps the ball. The weight of the ball is left out.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

STEP = 0.02

ball = tc.library.six_bar_ball(bar_length=1.0)
model = tc.Model(ball, strings=tc.LinearStrings(stiffness=500.0, damping=2.0))
plant = tc.linearize(model, tc.prestress(ball, force_density=40.0), input="rest_length")

# %%
# Inclinations come from gravity, rates from the gyroscopes, rest lengths from the motors.

sensors = tc.Sensors(
    structure=ball,
    bar_inclination=0.01,
    gyroscope=0.02,
    bias={"gyroscope": (0.05, 1e-4)},
    encoder=0.05,
    motor=tc.Motor(drum_radius=0.01, gear_ratio=20.0, zero=1.0),
)
with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # named in the report
    estimator = tc.KalmanFilter(plant, sensors, sample_time=STEP, rest_length_error=(2e-3, 1e-5))

# %%
# Which readings tell what? Nothing says where the ball points, so that this direction is left
# alone, and with it a steady turn, which looks like a bias. So is a mechanism that turns no bar
# up or down and that no string reaches.

report = estimator.observability()
print(report.table())

# %%
# The ball starts out of shape. The filter expects the shape at rest.

Q, R = tc.energy_weights(plant, by_mode=True)
with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # of the same mechanism
    regulator = tc.LQR(plant, Q, 10.0 * R, sample_time=STEP)
rng = np.random.default_rng(2)
start = plant.to_nodes(0.01 * rng.normal(size=plant.degrees_of_freedom))
run = tc.simulate(
    model,
    6.0,
    start,
    controller=regulator,
    estimator=estimator,
    rest_length=plant.rest_length,
    seed=1,
    step=1e-3,
)
told = run.control.estimate

# %%
# The true and the estimated shape 0.1 s after the start, laid over each other: a shape has no place
# and no heading here. Nodes are known to some millimetres from then on.


def laid_over(nodes):
    """Return a shape where the plant has it, without its motion as one body."""
    return plant.to_nodes(plant.measure(nodes, 0 * nodes)[: plant.degrees_of_freedom])


time = told.time
true, found = (
    [laid_over(nodes) for nodes in np.moveaxis(motion, 2, 0)]
    for motion in (run.nodes[:, :, :-1:20], told.nodes)
)
off = np.array([np.linalg.norm(a - b, axis=0).max() for a, b in zip(true, found, strict=True)])
print(f"farthest node: {1e3 * off[0]:.1f} mm off at first, {1e3 * off[50:].max():.1f} mm after 1 s")

figure = plt.figure(figsize=(6, 5), layout="constrained")
view = figure.add_subplot(projection="3d")
for nodes, color, label in ((true[5], "black", "true"), (found[5], "tab:orange", "estimated")):
    for pairs, width in ((ball.bars, 3.0), (ball.strings, 0.8)):
        for start_node, end_node in pairs:
            view.plot(*nodes[:, [start_node, end_node]], color=color, linewidth=width, label=label)
            label = "_"
view.set(xlabel="x, m", ylabel="y, m", zlabel="z, m", title="0.1 s after the start")
view.set_aspect("equal")
view.legend()

# %%
# The bias about the axes across the bars: what is estimated, within two deviations, and what it is.

told_bias = [i for i in np.flatnonzero(sensors.bias_deviation) if told.bias_deviation[i, -1] < 5e-3]
_, axes = plt.subplots(figsize=(6, 4), layout="constrained")
for i, color in zip(told_bias[:4], ("C0", "C1", "C2", "C3"), strict=True):
    low, high = (told.bias[i] + sign * 2 * told.bias_deviation[i] for sign in (-1, 1))
    axes.fill_between(time, low, high, color=color, alpha=0.2, linewidth=0)
    axes.plot(time, told.bias[i], color=color, label=sensors.readings[sensors.reading_of[i]])
    axes.plot(time, told.actual_bias[i], color=color, linestyle="--")
axes.set(xlabel="time, s", ylabel="bias, rad/s", title="dashed: actual", ylim=(-0.15, 0.15))
axes.legend()
bias_error = np.abs(told.bias - told.actual_bias)[told_bias, -1]
print(f"bias within {1e3 * bias_error.max():.1f} mrad/s in the end")

if __name__ == "__main__":
    plt.show()
