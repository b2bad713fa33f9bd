"""
A mast deployed by its struts
=============================

The six bars of a mast of two prisms are telescopic struts. They lift it from 1.29 m to 1.75 m, and
its elastic strings keep their rest lengths. MPC commands the lengths of the bars and damps what a
gust leaves.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

SAMPLE, SHARE = 0.05, 0.8  # s, of the full length

# %%
# The mast stands on three nodes. Its strings are long springs: they are taut in all shapes.

tower = tc.prism_tower(2)
feet = np.flatnonzero(np.isclose(tower.nodes[2], tower.nodes[2].min()))
mast = replace(tower, fixed=feet.tolist())
model = tc.Model(mast, tc.LinearStrings(200.0, damping=0.3), gravity=9.81, external_force=True)
rest = tc.prestress(mast, min_force_density=40.0, external_force=model.constant_force)
plant = tc.linearize(model, rest, input="bar_length")

# %%
# The shapes at rest for lengths from 80 % on.

time = np.linspace(0.2, 2.2, 9)
shares = np.linspace(SHARE, 1.0, len(time))
path = tc.shape.strut_path(plant, np.outer(mast.bar_length, shares), time)
drawing = tc.plot.structure(plant)
tc.plot.structure(mast, path.nodes[:, :, 0], ax=drawing.ax, faint=True)

# %%
# The drives of the bars have a rate and a stroke. From sample to sample a length goes in a straight
# line.

drives = tc.Winches(ramp=True, rate=0.4, shortest=1.0, longest=1.5)
mpc = tc.MPC(
    plant,
    horizon=20,
    sample_time=SAMPLE,
    winches=drives,
    reference=path,
    min_force_density=2.0,
)

# %%
# A gust of 0.15 s meets the top on the way. MPC is compared with the same lengths played without
# feedback.

short, start = SHARE * mast.bar_length, path.nodes[:, :, 0]
top = np.flatnonzero(np.isclose(mast.nodes[2], mast.nodes[2].max()))
force = np.zeros_like(start)
force[0, top] = 6.0  # N
calm = np.zeros_like(force)
gust = tc.Profile([1.0, 1.0, 1.15, 1.15], np.stack([calm, force, force, calm], axis=-1))
run = tc.simulate(
    model, 4.0, start, bar_length=short, controller=mpc, winches=drives, external_force=gust
)
played = tc.simulate(
    model,
    4.0,
    start,
    rest_length=plant.rest_length,
    bar_length=tc.Profile(time, np.outer(mast.bar_length, shares), "cubic"),
    external_force=gust,
)
print(run.summary())

# %%
# Under MPC the top is back within two seconds; without it, it goes on swaying.

figure, ax = plt.subplots(layout="constrained")
off = {}
for name, motion, style in (("MPC", run, "-"), ("played", played, "--")):
    wanted = [[np.interp(motion.time, time, path.nodes[a, n]) for n in top] for a in range(3)]
    off[name] = np.linalg.norm(motion.nodes[:, top] - np.array(wanted), axis=0).max(axis=0)
    ax.plot(motion.time, 1000 * off[name], style, label=name)
ax.set(xlabel="time, s", ylabel="top off its path, mm")
ax.legend(frameon=False)

# %%
# The lengths of the struts, what they carry, and their work: they lift the mast and stretch its
# strings.

panels = tc.plot.struts(run)
plt.show()
