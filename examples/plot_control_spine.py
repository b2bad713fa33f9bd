"""
A spine of rigid vertebrae bends
================================

Strings hold six vertebrae above one another, under gravity. The lowest one is fixed. Each vertebra
is a rigid body of ten bars. Winches wind the forty strings, so that the spine bends sideways: first
by LQR, then by MPC along a path.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

SAMPLE, DURATION, LEAN, LEAST = 0.02, 1.0, 0.1, 40.0  # s, s, m, N/m

spine = tc.library.spine(vertebrae=6)
model = tc.Model(spine, strings=tc.LinearStrings(stiffness=2000.0, damping=4.0), gravity=9.81)
print(f"{len(spine.free_rows)} coordinates of nodes, class {spine.structure_class}")
tc.plot.structure(spine)


def at_rest(nodes):
    """Return the prestress of a shape with each string taut, under the weights."""
    shape = replace(spine, nodes=nodes)
    return tc.prestress(shape, min_force_density=LEAST, external_force=model.constant_force)


# %%
# Of the coordinates of the nodes, six for each moving vertebra are left.

plant = tc.linearize(model, at_rest(spine.nodes), input="rest_length")
found = tc.modes(plant)
print(plant)
print(f"frequencies from {found.frequency[0]:.2f} to {found.frequency[-1]:.1f} Hz")

# %%
# The highest centre is to move along x by 0.1 m, the others by the square of their
# height, and all of them stay as high as they are.

centres = 5 * np.arange(1, 6)
rows = np.eye(spine.nodes.size)[np.concatenate([3 * centres, 3 * centres + 1, 3 * centres + 2])]
wanted = np.concatenate([LEAN * (np.arange(1, 6) / 5) ** 2, np.zeros(10)])
direction = np.linalg.lstsq(rows @ plant.basis, wanted, rcond=None)[0]
share = np.linspace(0.0, 1.0, 11)
shapes = [plant.to_nodes(each * direction) for each in share**2 * (3 - 2 * share)]
rests = [at_rest(nodes) for nodes in shapes]
goal = tc.linearize(model, rests[-1], input="rest_length")

# %%
# Both controllers are held to 0.2 m/s at each winch.

winches = tc.Winches(rate=0.2, shortest=0.01, ramp=True)
reference = tc.Reference(
    DURATION * share,
    np.stack(shapes, axis=-1),
    np.stack([rest.force_density for rest in rests], axis=-1),
)
Q, R = tc.energy_weights(goal, by_mode=True)
controllers = {
    "MPC": tc.MPC(plant, horizon=6, sample_time=SAMPLE, reference=reference, winches=winches),
    "LQR": tc.LQR(goal, Q, R, sample_time=SAMPLE, winches=winches),
}
runs = {
    name: tc.simulate(
        model,
        2 * DURATION,
        nodes=spine.nodes,
        controller=controller,
        winches=winches,
        rest_length=plant.rest_length,
        output_step=SAMPLE,
        method="rk4",
        step=2e-3,
        project=True,
    )
    for name, controller in controllers.items()
}
top = centres[-1]
lean = {name: run.nodes[0, top] for name, run in runs.items()}
lengths = max(
    np.abs(np.linalg.norm(spine.bar_vectors(nodes), axis=0) / spine.bar_length - 1).max()
    for nodes in np.moveaxis(runs["MPC"].nodes, 2, 0)
)
for name, run in runs.items():
    print(
        f"{name}: top {1e3 * (lean[name][-1] - shapes[-1][0, top]):.3f} mm off its goal, least γ "
        f"{run.force_density.min():.1f} N/m, {run.control.status_count}"
    )
print(f"lengths of bars kept to {lengths:.0e}")

# %%
# The spine at the start and the end, its top, and the winches of MPC.

figure = plt.figure(figsize=(7.5, 7.5), layout="constrained")
grid = figure.add_gridspec(2, 2, height_ratios=(1.8, 1.0))
for column, (k, title) in enumerate(((0, "start"), (-1, "end, MPC"))):
    ax = figure.add_subplot(grid[0, column], projection="3d")
    tc.plot.structure(spine, runs["MPC"].nodes[:, :, k], ax=ax, legend=False)
    ax.view_init(8, -85)
    ax.set_axis_off()
    ax.set_title(title)
along = np.interp(runs["MPC"].time, reference.time, reference.nodes[0, top])
tc.plot.history(
    runs["MPC"].time,
    {**lean, "reference": along},
    "lean of the top, m",
    ax=figure.add_subplot(grid[1, 0]),
)
tc.plot.history(
    runs["MPC"].control.time,
    {
        name: runs["MPC"].control.winch_rate[spine.strings_in(name)]
        for name in ("vertical", "saddle")
    },
    "winches of MPC, m/s",
    ax=figure.add_subplot(grid[1, 1]),
)

if __name__ == "__main__":
    plt.show()
