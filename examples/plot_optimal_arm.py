"""
Fastest motion of the arm
=========================

The arm lifts its tip by 10 cm, from rest to rest, with winches of 0.8 m/s. The path through
equilibria winds as fast as the winches can, and swings past the goal. The fastest motion that ends
at rest takes a little longer: its winches turn back on the way.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

RATE, LIFT = 0.8, 0.1  # m/s, m

arm = tc.library.arm()
model = tc.Model(arm, strings=tc.LinearStrings(stiffness=500.0, damping=2.0))
rest = tc.prestress(arm, min_force_density=50.0)
raised = tc.NodesAt([5], arm.nodes[:, [5]] + [[0.0], [LIFT]])
goal = tc.shape_target(model, raised, force_density=50.0)
winches = tc.Winches(rate=RATE, shortest=0.1)

# %%
# Both ways. The plan is replayed by the simulator, which knows nothing of it.

motion = tc.optimal_motion(model, rest, goal, winches=winches)
path = tc.shape_path(model, rest, goal, winches=winches, step=0.005, min_force_density=5.0)
print(motion.summary())

# %%
# What becomes of the tip after each of them, if winches hold what they have at the end.

LATER = 0.5  # s
profiles = {
    "fastest to rest": motion.profile,
    "path through equilibria": tc.Profile(path.time, path.rest_length),
}
runs = {
    name: tc.simulate(model, LATER, rest_length=profile, output_step=1e-3)
    for name, profile in profiles.items()
}
time = np.linspace(0.0, LATER, 501)
heights = {
    name: np.interp(time, run.time, run.nodes[1, 5] - arm.nodes[1, 5]) for name, run in runs.items()
}

# %%
# Shapes along the fastest motion, the start in grey. Below are the tip, winches (positive where
# they pay out) and tensions. The tip comes to rest after all winches have turned back; on the path
# through equilibria it swings on.

figure = plt.figure(figsize=(7.5, 8.5), layout="constrained")
grid = figure.add_gridspec(4, 1, height_ratios=(2.0, 1.0, 1.0, 1.0))
ax = figure.add_subplot(grid[0])
for share in (0.0, 0.5):
    k = round(share * (len(motion.time) - 1))
    tc.plot.structure(arm, motion.nodes[:, :, k], ax=ax, faint=True)
tc.plot.structure(arm, motion.nodes[:, :, -1], ax=ax)

tc.plot.history(
    time,
    heights,
    "tip, m",
    ax=figure.add_subplot(grid[1]),
    references={"goal": LIFT},
)
groups = {name: arm.strings_in(name) for name in dict.fromkeys(arm.string_groups)}
winding = np.linspace(0.0, motion.duration, 401)[:-1]
tc.plot.history(
    winding,
    {name: motion.profile.rate(winding)[strings] for name, strings in groups.items()},
    "winch, m/s",
    ax=figure.add_subplot(grid[2]),
    references={"limit out": RATE, "limit in": -RATE},
)
shapes = np.moveaxis(motion.run.nodes, 2, 0)
lengths = np.column_stack([arm.string_length(nodes) for nodes in shapes])
tension = motion.run.force_density * lengths
tc.plot.history(
    motion.run.time,
    {name: tension[strings] for name, strings in groups.items()},
    "tension, N",
    ax=figure.add_subplot(grid[3]),
)

if __name__ == "__main__":
    plt.show()
