"""
A planar T-bar of class 2, by LQR, MPC and NMPC
===============================================

Two bars in line meet in a joint. Under compression the joint would give way, but strings hold it to
a third bar across. Six winches move the joint sideways and turn that bar. One end of the T-bar is
on a pin, the other on a roller.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

SAMPLE, DURATION, ASIDE, TURN, LEAST = 0.02, 1.0, 0.2, 0.3, 10.0  # s, s, m, rad, N/m

# %%
# Nodes: pin, joint, roller, lower and upper end of the bar across.

t_bar = tc.Structure(
    nodes=[[0.0, 1.0, 2.0, 1.0, 1.0], [0.0, 0.0, 0.0, -0.5, 0.5]],
    bars=[(0, 1), (1, 2), (3, 4)],
    strings=[(0, 3), (3, 2), (2, 4), (4, 0), (3, 1), (1, 4)],
    bar_mass=[1.0, 1.0, 0.8],
    string_groups=["side"] * 4 + ["joint"] * 2,
    fixed=[0, (2, "y")],
)
tc.plot.structure(t_bar, labels=True, member_labels=True)
model = tc.Model(t_bar, strings=tc.LinearStrings(stiffness=400.0, damping=1.0))


def at_rest(nodes):
    """Return the prestress of a shape with each string taut."""
    return tc.prestress(replace(t_bar, nodes=nodes), min_force_density=LEAST)


rest = at_rest(t_bar.nodes)
plant = tc.linearize(model, rest, input="rest_length")
print(f"class {t_bar.structure_class}, {rest.self_stress_states} states of self-stress")
print(tc.modes(plant).table())

# %%
# The joint goes up, and the bar across turns with its centre on the joint.

x, y = (np.eye(10)[2 * np.arange(5) + axis] for axis in (0, 1))
rows = np.array([y[1], (x[3] - x[4]) / 1.0, y[3] + y[4] - 2 * y[1], x[3] + x[4] - 2 * x[1]])
direction = np.linalg.solve(rows @ plant.basis, [ASIDE, TURN, 0.0, 0.0])
share = np.linspace(0.0, 1.0, 21)
shapes = [plant.to_nodes(each * direction) for each in share**2 * (3 - 2 * share)]
rests = [at_rest(nodes) for nodes in shapes]
goal = tc.linearize(model, rests[-1], input="rest_length")

winches = tc.Winches(rate=0.5, shortest=0.1, ramp=True)
reference = tc.Reference(
    DURATION * share,
    np.stack(shapes, axis=-1),
    np.stack([each.force_density for each in rests], axis=-1),
)
Q, R = tc.energy_weights(goal, by_mode=True)
options = {
    "horizon": 15, "sample_time": SAMPLE, "reference": reference, "winches": winches,
    "min_force_density": 1.0,
}  # fmt: skip
controllers = {
    "LQR": tc.LQR(goal, Q, 2 * R, sample_time=SAMPLE, winches=winches),
    "MPC": tc.MPC(plant, **options),
    "NMPC": tc.NMPC(plant, **options),
}
runs = {
    name: tc.simulate(
        model,
        2 * DURATION,
        nodes=t_bar.nodes,
        controller=controller,
        winches=winches,
        rest_length=plant.rest_length,
        output_step=SAMPLE,
    )
    for name, controller in controllers.items()
}
aside = {name: run.nodes[1, 1] for name, run in runs.items()}
off = {
    name: 1e3 * np.linalg.norm(run.nodes[:, :, -1] - shapes[-1], axis=0).max()
    for name, run in runs.items()
}
for name, run in runs.items():
    print(
        f"{name}: nodes at most {off[name]:.3f} mm off the goal, least γ "
        f"{run.force_density.min():.1f} N/m, {run.control.status_count}"
    )

# %%
# The shapes, the way of the joint, and the force densities under NMPC.

figure = plt.figure(figsize=(7.5, 7.5), layout="constrained")
grid = figure.add_gridspec(3, 2, height_ratios=(1.3, 1.0, 1.0))
for column, (k, title) in enumerate(((0, "start"), (-1, "end, NMPC"))):
    ax = figure.add_subplot(grid[0, column])
    tc.plot.structure(t_bar, runs["NMPC"].nodes[:, :, k], ax=ax, legend=False)
    ax.set_title(title)
time = runs["NMPC"].time
wanted = np.interp(time, reference.time, reference.nodes[1, 1])
tc.plot.history(time, {**aside, "reference": wanted}, "joint, m", ax=figure.add_subplot(grid[1, :]))
tc.plot.history(
    time,
    {name: runs["NMPC"].force_density[t_bar.strings_in(name)] for name in ("side", "joint")},
    "γ, N/m",
    ax=figure.add_subplot(grid[2, :]),
)

if __name__ == "__main__":
    plt.show()
