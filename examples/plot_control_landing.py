"""
Which strings make a thrown ball go farther?
============================================

A six-bar ball is thrown, hits the ground and slides. How far its centre has come after a second
depends on the rest lengths of its 24 strings. :func:`tenscontrol.gradient` finds all 24 derivatives
in one pass backward, through bounces, friction and strings that go slack.
"""

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

ball = tc.library.six_bar_ball()
ground = tc.Ground(stiffness=5e3, damping=0.3, friction=0.6)
model = tc.Model(ball, tc.LinearStrings(800.0, damping=2.0), gravity=9.81, ground=ground)
start = ball.nodes - [[0.0], [0.0], [ball.nodes[2].min() - 0.3]]  # 0.3 m above the ground
throw = np.zeros(ball.nodes.shape)
throw[0] = 1.5  # m/s
usual = 0.95 * ball.string_length()
deep = tc.HealthLimits(penetration=None)  # the ground is soft


def thrown(rest_length):
    """Return a throw of a second."""
    return tc.simulate(model, 1.0, start, throw, rest_length=rest_length, limits=deep)


def way(time, nodes, velocities):
    """Return how far the centre has come, m."""
    return ca.sum2(nodes[0, :]) / 12


# %%
# The derivatives
# ---------------

run = thrown(usual)
found = tc.gradient(run, way, ["rest_length"])
slope = found.slope["rest_length"]
print(found)

figure, ax = plt.subplots(figsize=(6.4, 2.8), layout="constrained")
ax.bar(range(24), slope)
ax.axhline(0.0, color="0.4", linewidth=0.8)
ax.set(xlabel="string", ylabel="m of way per m of rest length")

# %%
# A step along them
# -----------------
#
# Rest lengths change by up to 1 cm, in the direction of the slope. The way grows by about as much
# as the slope says; farther along, bounces come at other times, and it says less.

steps = np.linspace(0.0, 0.02, 9)  # m, of the string that changes most
along = slope / np.abs(slope).max()
ways = [thrown(usual + step * along).nodes[0, :, -1].mean() for step in steps]

# sphinx_gallery_thumbnail_number = 2
figure, ax = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
ax.plot(1e3 * steps, ways, "o-", label="runs")
ax.plot(1e3 * steps, found.value + steps * (slope @ along), "--", label="slope")
ax.set(xlabel="largest change of a rest length, mm", ylabel="way of the centre, m")
ax.legend(frameon=False)

if __name__ == "__main__":
    plt.show()
