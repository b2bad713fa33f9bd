"""
LQR and MPC lift a planar arm
=============================

A planar arm of three frames carries a payload at its tip. Bars of neighbouring frames share nodes.
Winches wind its nine strings and lift the tip by 0.2 m, under gravity.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

SAMPLE, DURATION, RISE, LEAST = 0.02, 1.5, 0.2, 30.0  # s, s, m, N/m
LAW = tc.LinearStrings(stiffness=1000.0, damping=2.0)

# %%
# Two nodes are fixed, the others move in the plane. The payload of 0.5 kg is at the
# lower node of the tip.

arm = tc.library.arm(sections=3, length=0.5, height=0.4, bar_mass=0.3)
tip = 6
arm = replace(arm, point_mass=0.5 * (np.arange(8) == tip))
model = tc.Model(arm, strings=LAW, gravity=9.81)
print(f"class {arm.structure_class}, {len(arm.free_rows)} coordinates of nodes")
tc.plot.structure(arm)


def at_rest(nodes):
    """Return the prestress of a shape with each string taut, under the weights."""
    shape = replace(arm, nodes=nodes)
    return tc.prestress(shape, min_force_density=LEAST, external_force=model.constant_force)


plant = tc.linearize(model, at_rest(arm.nodes), input="rest_length")
print(plant)
print(tc.modes(plant).table())

# %%
# Of all motions that lift both nodes of the tip alike, that with the least kinetic energy. The
# coordinates keep the lengths of the bars on the way.

heights = np.eye(arm.nodes.size)[[2 * tip + 1, 2 * tip + 3]]
direction = np.linalg.pinv(heights @ plant.basis).sum(axis=1)
share = np.linspace(0.0, 1.0, 21)
smooth = share**3 * (10 - 15 * share + 6 * share**2)
shapes = [plant.to_nodes(RISE * each * direction) for each in smooth]
rests = [at_rest(shape) for shape in shapes]
goal = tc.linearize(model, rests[-1], input="rest_length")

# %%
# MPC follows the shapes; LQR is designed about the last of them, and is asked for it at once. Its
# winches stop at the speed of their motors: 0.3 m/s, at 600 rad/s through a gear of 20 on a drum of
# 1 cm.

Q, R = tc.energy_weights(goal, by_mode=True)
motor = tc.Motor(drum_radius=0.01, gear_ratio=20.0, speed=600.0)
winches = tc.Winches(shortest=0.1, ramp=True, motor=motor)
reference = tc.Reference(
    DURATION * share,
    np.stack(shapes, axis=-1),
    np.stack([rest.force_density for rest in rests], axis=-1),
)
controllers = {
    "MPC": tc.MPC(
        plant,
        horizon=15,
        sample_time=SAMPLE,
        reference=reference,
        winches=winches,
        min_force_density=5.0,
    ),
    "LQR": tc.LQR(goal, Q, 5 * R, sample_time=SAMPLE, winches=winches),
}
runs = {
    name: tc.simulate(
        model,
        2 * DURATION,
        nodes=arm.nodes,
        controller=controller,
        winches=winches,
        rest_length=plant.rest_length,
        output_step=SAMPLE / 4,
    )
    for name, controller in controllers.items()
}
lengths = {
    name: max(
        np.abs(np.linalg.norm(arm.bar_vectors(nodes), axis=0) / arm.bar_length - 1).max()
        for nodes in np.moveaxis(run.nodes, 2, 0)
    )
    for name, run in runs.items()
}
lift = {name: run.nodes[1, tip] - run.nodes[1, tip, 0] for name, run in runs.items()}
for name, run in runs.items():
    print(
        f"{name}: tip {1e3 * (lift[name][-1] - shapes[-1][1, tip] + arm.nodes[1, tip]):.3f} mm off "
        f"its goal, least γ {run.force_density.min():.1f} N/m, lengths of bars "
        f"{lengths[name]:.0e}, {run.control.status_count}"
    )

# %%
# The shapes at the start and the end, the tip, and the winches of MPC.

figure = plt.figure(figsize=(7.5, 7.0), layout="constrained")
grid = figure.add_gridspec(3, 2, height_ratios=(1.3, 1.0, 1.0))
for column, (k, title) in enumerate(((0, "start"), (-1, "end, MPC"))):
    ax = figure.add_subplot(grid[0, column])
    tc.plot.structure(arm, runs["MPC"].nodes[:, :, k], ax=ax, legend=False)
    ax.set_title(title)
wanted = np.interp(runs["MPC"].time, reference.time, reference.nodes[1, tip])
tc.plot.history(
    runs["MPC"].time,
    {**lift, "reference": wanted - arm.nodes[1, tip]},
    "lift of the tip, m",
    ax=figure.add_subplot(grid[1, :]),
)
tc.plot.history(
    runs["MPC"].control.time,
    {
        name: runs["MPC"].control.winch_rate[arm.strings_in(name)]
        for name in ("lower", "upper", "upright")
    },
    "winches of MPC, m/s",
    ax=figure.add_subplot(grid[2, :]),
    references={"limit out": 0.3, "limit in": -0.3},
)

# %%
# What it takes from the motors. Positive power lifts the arm and stretches strings; where the arm
# comes down or a string is let out, a motor brakes. Holding the payload takes torque, but no power.

for name, run in runs.items():
    motors = run.control.motors
    print(
        f"{name}: one motor at most {motors.torque.max():.3f} N m and {motors.power.max():.2f} W, "
        f"all together {motors.energy[:, -1].sum():.2f} J (to {motors.energy_error:.0e} J)"
    )
panels = tc.plot.motors(runs["MPC"])

if __name__ == "__main__":
    plt.show()
