"""
A mast of least mass: how many stages?
======================================

A deployable mast of 6 m carries 10 kg on its top. Each stage has three longerons, a triangle of
battens, and crossed strings on its three faces. With more stages the longerons are shorter and
buckle later, but there are more joints. :func:`tenscontrol.design` finds the sections of least mass
for each number of stages. The lightest mast is then held still in a gust by motors in its lowest
two stages.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

HEIGHT, RADIUS, PAYLOAD, JOINT = 6.0, 0.25, 10.0, 0.02  # m, m, kg, kg a node
PRESS, SIDE, TAUT = 500.0, 60.0, 50.0  # N, N, N/m
STAGES = (4, 6, 8, 10, 12, 16, 20)
carbon, rope = tc.sizing.materials["carbon tube"], tc.sizing.materials["dyneema"]


def mast(stages):
    """Return a mast with a payload on its top and a mass in each joint."""
    around = 2 * np.pi * np.arange(3) / 3
    ring = RADIUS * np.array([np.cos(around), np.sin(around)])
    levels = np.linspace(0.0, HEIGHT, stages + 1)
    bars, strings = [], []
    for first in range(0, 3 * stages, 3):
        for k in range(3):
            one, other = first + k, first + (k + 1) % 3
            bars += [(one, one + 3), (one + 3, other + 3)]
            strings += [(one, other + 3), (other, one + 3)]
    mass = np.full(3 * stages + 3, JOINT)
    mass[-3:] += PAYLOAD / 3
    nodes = np.hstack([np.vstack([ring, np.full(3, level)]) for level in levels])
    return tc.Structure(nodes, bars, strings, 1.0, fixed=[0, 1, 2], point_mass=mass)


# %%
# Least mass
# ----------
#
# The payload presses while the structure is accelerated, and pushes to any of six sides. Members
# carry twice their forces, every string is taut.


def sized(stages):
    """Return the sections of least mass of a mast."""
    structure = mast(stages)
    loads = []
    for angle in np.deg2rad(np.arange(0, 360, 60)):
        load = np.zeros(structure.nodes.shape)
        load[:, -3:] = np.array([[SIDE * np.cos(angle)], [SIDE * np.sin(angle)], [-PRESS]]) / 3
        loads.append(load)
    return tc.design(
        structure, bars=carbon, strings=rope, loads=loads, safety=2.0, tube=tc.sizing.Tube(0.85),
        min_force_density=TAUT, restarts=1,
    )  # fmt: skip


found = {stages: sized(stages) for stages in STAGES}
joints = {stages: 3 * stages * JOINT for stages in STAGES}
mass = {stages: found[stages].mass + joints[stages] for stages in STAGES}
best = min(mass, key=mass.get)
light = found[best]
print(f"{best} stages: {mass[best]:.2f} kg, {light.mass:.2f} kg of it in members")
print(f"strings are {1e3 * 2 * np.sqrt(light.string_area.max() / np.pi):.1f} mm thick at most")

figure, ax = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
ax.plot(STAGES, list(mass.values()), "o-", label="all")
ax.plot(STAGES, [each.mass for each in found.values()], "s--", label="bars and strings")
ax.plot(STAGES, list(joints.values()), "^:", label="joints")
ax.set(xlabel="stages", ylabel="mass, kg", ylim=(0, None))
ax.legend(frameon=False)
tc.plot.structure(light.structure)

# %%
# Modes
# -----
#
# Strings are thin, and their stretch gives the lowest frequencies: that of the twist, and those of
# bending to two sides. The lighter the longerons, the more they would give as well, which are rigid
# here. :func:`tenscontrol.rigidity` says by how much that lowers each frequency, and warns of more
# than 1 %.

rigid = {}
for stages, each in found.items():
    model = tc.Model(each.structure, tc.ElasticStrings(each.axial_rigidity))
    rest = tc.prestress(each.structure, min_force_density=TAUT)
    held = tc.linearize(model, rest, input="rest_length", coordinates="minimal")
    with warnings.catch_warnings(action="ignore", category=tc.plant.RigidityWarning):
        rigid[stages] = tc.rigidity(held, each.bar_axial_rigidity, count=3)

figure, axes = plt.subplots(1, 2, figsize=(7.5, 3.2), layout="constrained")
for mode, style in enumerate(("o-", "s--", "^:")):
    frequencies, changes = zip(
        *((each.frequency[mode], each.change[mode]) for each in rigid.values()), strict=True
    )
    axes[0].plot(STAGES, frequencies, style, label=f"mode {mode}")
    axes[1].plot(STAGES, 100 * np.array(changes), style)
axes[0].set(xlabel="stages", ylabel="frequency with rigid bars, Hz", ylim=(0, None))
axes[1].set(xlabel="stages", ylabel="change by elastic bars, %")
axes[0].legend(frameon=False)

# %%
# A gust
# ------
#
# For half a second 25 N push on the top. Held strings let the mast swing on. Twelve motors, on the
# strings of the lowest two stages, still it; the limit of :func:`tenscontrol.control.buckling`
# keeps every bar at 1.5 times its force.

strings = tc.ElasticStrings(light.axial_rigidity, damping=5.0)
model = tc.Model(light.structure, strings, external_force=True)
rest = tc.prestress(light.structure, min_force_density=TAUT)
plant = tc.linearize(model, rest, input="rest_length", actuated=range(12))
winches = tc.Winches(rate=0.05, shortest=0.1, longest=2.0)
mpc = tc.MPC(
    plant, horizon=15, sample_time=0.05, min_force_density=5.0, winches=winches,
    outputs=[tc.control.buckling(light, safety=1.5, penalty=1e3)],
)  # fmt: skip
push = np.zeros((*light.structure.nodes.shape, 4))
push[0, -3:, 1:3] = 25.0 / 3
gust = tc.Profile([0.0, 0.1, 0.4, 0.5], push)
given = {"rest_length": plant.rest_length, "external_force": gust, "output_step": 0.01}
runs = {
    "strings held": tc.simulate(model, 3.0, **given),
    "MPC": tc.simulate(model, 3.0, controller=mpc, winches=winches, **given),
}
strong = {name: tc.strength(run, light) for name, run in runs.items()}
top = {name: run.nodes[0, -3:].mean(axis=0) for name, run in runs.items()}
for name in runs:
    print(f"{name}: {1e3 * np.abs(top[name][-50:]).max():.1f} mm in the last half second")
    print(strong[name])

# sphinx_gallery_thumbnail_number = 1
figure, axes = plt.subplots(2, 1, sharex=True, figsize=(6.4, 4.6), layout="constrained")
sway = {name: 1e3 * each for name, each in top.items()}
tc.plot.history(runs["MPC"].time, sway, "top, mm", ax=axes[0])
tc.plot.strength(strong["MPC"], members=3, ax=axes[1])

if __name__ == "__main__":
    plt.show()
