"""
A ball sized for its drop
=========================

A six-bar ball carries a payload of 2 kg at its centre, held by twelve strings, and falls from 2 m.
Its forces come from the motion, which a list of loads does not foresee. So drop and sections take
turns: :func:`tenscontrol.strength` says how many times its force the weakest bar and the weakest
string could carry along a drop, and sections follow, until both have a safety of 1.5.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import tenscontrol as tc

LENGTH, PAYLOAD, STIFFNESS = 1.0, 2.0, 4e3  # m, kg, N/m
HEIGHTS, SAFETY, PRESTRESS = (0.5, 1.0, 2.0, 4.0), 1.5, 10.0  # m, times the force, N/m
RATIO = 0.5  # force density of the strings of the payload over that of the shell
metal, rope = tc.sizing.materials["aluminium"], tc.sizing.materials["dyneema"]

# %%
# The ball
# --------
#
# The strings of the payload draw the ball together, and it falls on a triangle of strings. Strings
# are ropes in series with springs, which give the stiffness.

ball = tc.library.six_bar_ball(bar_length=LENGTH)
nodes = np.where(np.isclose(np.abs(ball.nodes), LENGTH / 4), 4 / (4 + RATIO), 1.0) * ball.nodes
face = nodes[:, [8, 4, 0]].sum(axis=1)
down = Rotation.align_vectors([[0.0, 0.0, -1.0]], [face])[0].as_matrix()
lander = tc.Structure(
    np.column_stack([down @ nodes, np.zeros(3)]),
    bars=ball.bars,
    strings=[*ball.strings, *((node, 12) for node in range(12))],
    bar_mass=0.1,
    string_node_mass=[PAYLOAD],
)
rest = tc.prestress(lander, min_force_density=PRESTRESS)
ground = tc.Ground(stiffness=5e4, damping=0.1, friction=0.5, height=lander.nodes[2].min())


def with_radii(bar_radius, string_radius):
    """Return the lander with bars that are tubes, and ropes."""
    return tc.sections(
        lander, bars=metal, bar_radius=bar_radius, bar_inner_radius=0.85 * bar_radius,
        strings=rope, string_radius=string_radius,
    )  # fmt: skip


def drop(sized, height, **limits):
    """Return the run from the moment of touching."""
    strings = tc.LinearStrings(STIFFNESS, damping=2.0)
    model = tc.Model(sized.structure, strings, gravity=9.81, ground=ground)
    wound = tc.to_rest_length(model, lander.nodes, rest.force_density).rest_length
    speeds = np.zeros_like(lander.nodes)
    speeds[2] = -np.sqrt(2 * 9.81 * height)
    return tc.simulate(
        model, 0.15, velocities=speeds, rest_length=wound, output_step=2.5e-4, error="none",
        limits=tc.HealthLimits(crossings=None, **limits),
    )  # fmt: skip


# %%
# Drop, and size
# --------------
#
# Buckling goes with the fourth power of a radius, yield with its square. Heavier bars hit harder:
# a few turns settle it.


def sized_for(height):
    """Return sections with this safety, and the strength of the drop."""
    bar_radius, string_radius = 0.006, 0.0005
    for _ in range(8):
        sized = with_radii(bar_radius, string_radius)
        found = tc.strength(drop(sized, height), sized)
        least = found.bar_margin.min(), found.string_margin.min()
        if max(abs(margin / SAFETY - 1) for margin in least) < 0.01:
            break
        bar_radius *= (SAFETY / least[0]) ** 0.25
        string_radius *= (SAFETY / least[1]) ** 0.5
    return sized, found


designs = {height: sized_for(height) for height in HEIGHTS}
for height, (sized, found) in designs.items():
    print(f"{height:g} m: bars {sized.bar_mass.sum():.3f} kg, {found}")

# %%
# Along the drop from 2 m
# -----------------------
#
# Bars and strings come nearest to their limits at other times. Margins are those of forces as if
# they stayed: a bar takes longer to buckle than a shock lasts.

sized, found = designs[2.0]
tc.plot.strength(found, members=5)
drawing = tc.plot.utilization(found)
drawing.ax.view_init(5, -80)
drawing.ax.set_axis_off()

# %%
# Mass against height
# -------------------

# sphinx_gallery_thumbnail_number = 3
mass = {height: sized.mass for height, (sized, _) in designs.items()}
figure, ax = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
ax.plot(HEIGHTS, list(mass.values()), "o-")
ax.set(xlabel="height of the drop, m", ylabel="mass of bars and strings, kg", ylim=(0, None))

# %%
# What fails first from higher up? :class:`tenscontrol.HealthLimits` with these sections name it.

with warnings.catch_warnings(record=True, action="always") as caught:
    drop(sized, 8.0, sections=sized)
failure = str(caught[0].message)
print(failure)

# %%
# How far the numbers hold: outputs four times as close show the same peaks.

finer = tc.strength(
    tc.simulate(
        found.run.model, 0.15, velocities=found.run.velocities[:, :, 0],
        rest_length=found.run.rest_length[:, 0], output_step=6e-5, tolerance=1e-8, error="none",
        limits=tc.HealthLimits(crossings=None),
    ), sized,
)  # fmt: skip
off = abs(finer.margin / found.margin - 1)
print(f"the least margin is off by {off:.0e} of itself")

if __name__ == "__main__":
    plt.show()
