"""
Control of strings with mass
============================

LQR and MPC are designed on a prism with massless strings. They control prisms whose strings have
mass: 2, 4 and 8 segments each, and 0.1 % to 20 % of the mass of the bars in all strings together.
The controllers measure the six ends of the bars and wind nine strings, as before.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

STIFFNESS, DURATION, SAMPLE = 100.0, 3.0, 0.02

prism = tc.prism()
rest = tc.prestress(prism, force_density=17.320508)  # N/m in the top strings; 30 in the vertical
plant = tc.linearize(tc.Model(prism), rest)
Q, R = tc.energy_weights(plant)
q = 0.004 * np.random.default_rng(0).normal(size=9)
start = plant.to_nodes(q)

# %%
# The plants. A string keeps its stiffness when it is cut; its mass is shared by
# the new nodes.


def plant_with_mass(segments, share):
    """Return the model and its start: strings with this share of the mass of the bars."""
    if segments == 1:
        return tc.Model(prism, strings=tc.LinearStrings(STIFFNESS)), start
    mass = share * prism.bar_mass.sum() / len(prism.strings)
    structure = tc.subdivide(prism, segments, string_mass=mass)
    moved = tc.Structure(start, prism.bars, prism.strings, prism.bar_mass)
    nodes = tc.subdivide(moved, segments, string_mass=mass).nodes
    strings = tc.LinearStrings(STIFFNESS * tc.structure.segment_counts(structure))
    return tc.Model(structure, strings=strings), nodes


def step_for(model):
    """Return a step within which the fastest string turns by two radians at most."""
    fastest = np.abs(np.linalg.eigvals(tc.linearize(model, at_rest(model), "rest_length").A)).max()
    return min(2e-3, 2.0 / fastest)


def at_rest(model):
    """Return the prestress of a model of these."""
    structure = model.structure
    gamma = rest.force_density
    if structure.parent is not None:
        gamma = tc.structure.spread_force_density(structure, gamma)
    return tc.prestress(structure, gamma)


def off_target(run, after=-np.inf):
    """Return how far the farthest end of a bar is from its place, rigid motion apart, m."""
    off = []
    for k in np.flatnonzero(run.time > after):
        z = plant.measure(run.nodes[:, :6, k], run.velocities[:, :6, k])
        off.append(np.linalg.norm(plant.to_nodes(z[:9]) - prism.nodes, axis=0).max())
    return np.array(off)


# %%
# Every combination. What is left is the largest distance in the last half second.

controllers = {
    "LQR": tc.LQR(plant, Q, 0.1 * R, sample_time=SAMPLE, max_force_density=90.0),
    "MPC": tc.MPC(plant, horizon=10, sample_time=SAMPLE, max_force_density=80.0),
}
cases = [(1, 0.0)] + [(s, share) for s in (2, 4, 8) for share in (0.001, 0.01, 0.05, 0.2)]
left = {name: [] for name in controllers}
curves = {}
print("segments  string mass  left with LQR  left with MPC")
for segments, share in cases:
    model, nodes = plant_with_mass(segments, share)
    step = step_for(model)
    for name, controller in controllers.items():
        run = tc.simulate(
            model, DURATION, nodes, controller=controller, step=step, output_step=SAMPLE
        )
        left[name].append(off_target(run, DURATION - 0.5).max())
        if name == "MPC" and segments in (1, 8) and share in (0.0, 0.2):
            label = "massless" if segments == 1 else f"{segments} segments, {100 * share:g} %"
            curves[label] = off_target(run)
    values = "  ".join(f"{1e3 * left[name][-1]:10.4f} mm" for name in controllers)
    print(f"{segments:8d}  {100 * share:9.1f} %  {values}")
stable = all(max(values) < 1e-3 for values in left.values())
print("every combination is brought to rest" if stable else "some are not brought to rest")

# %%
# On the way: the controller hardly notices 20 % of string mass.

drawn = tc.plot.history(run.time, curves, "largest node error, m")
drawn.ax.set_yscale("log")

# %%
# The prism with strings of eight segments, at the end of the last run.

# sphinx_gallery_thumbnail_number = 2
tc.plot.structure(run)

# %%
# Where the strings are so heavy, or the controller so fast, that this does not
# hold, design on the subdivided model itself. ``command_parents`` makes the plant
# that winches see: they wind whole strings. The design with rest lengths as the
# input knows the strings' own vibrations. (With force densities as the input it
# is refused: nothing damps some of the sideways motions of the strings.)

heavy, nodes = plant_with_mass(2, 0.2)
full = tc.plant.command_parents(tc.linearize(heavy, at_rest(heavy), input="rest_length"))
weights = tc.energy_weights(full)
regulator = tc.LQR(full, weights[0], 0.1 * weights[1])
run = tc.simulate(
    heavy, DURATION, nodes, controller=regulator, sample_time=0.005, step=1e-3, output_step=SAMPLE
)
left_with_full = off_target(run, DURATION - 0.5).max()
print(f"{full.degrees_of_freedom} internal coordinates with strings, 9 without")
print(f"left with LQR designed on the strings as well: {1e3 * left_with_full:.4f} mm")

if __name__ == "__main__":
    plt.show()
