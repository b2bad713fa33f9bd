"""
Shape control, MPC and NMPC compared
====================================

Feedback linearization, also called shape control, makes the error of the node positions decay as a
spring and damper would. MPC and NMPC predict. All three move a prism from a disturbed start at 1 m
to a height of 0.85 m.
"""

import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

# %%
# The move: prisms of one bar length and any height are in balance with the same force densities.

prism = tc.prism(height=1.0)
model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
bar_length = prism.bar_length[0]


def of_height(height):
    """Return the prism with the same bars and this height, m."""
    return tc.prism(radius=tc.structure.prism_radius(bar_length, height), height=height)


time = np.linspace(0.0, 2.0, 101)
share = time / time[-1]
heights = 1.0 - 0.15 * (10 * share**3 - 15 * share**4 + 6 * share**5)
path = tc.Reference(time, np.stack([of_height(h).nodes for h in heights], axis=-1))
drawing = tc.plot.structure(prism, faint=True)
tc.plot.structure(of_height(0.85), ax=drawing.ax)

# %%
# Three controllers about the target, with the same sample time and bounds.

plant = tc.linearize(model, tc.prestress(of_height(0.85), force_density=10.0))
controllers = {
    "shape control": tc.FeedbackLinearization(
        plant, reference=path, sample_time=0.02, max_force_density=80.0, frequency=1.2
    ),
    "MPC": tc.MPC(plant, horizon=20, sample_time=0.02, max_force_density=80.0, reference=path),
    "NMPC": tc.NMPC(plant, horizon=20, sample_time=0.02, max_force_density=80.0, reference=path),
}

# %%
# Each of them twice: on actuators that hold forces, and on winches that hold rest lengths.

rest = tc.prestress(prism, force_density=10.0)  # N/m in the top strings; 17.32 in the vertical
start = tc.linearize(model, rest).to_nodes(0.003 * np.random.default_rng(0).normal(size=9))
wound = tc.to_rest_length(model, start, rest.force_density).rest_length
winches = {"winches": tc.Winches(rate=0.5, shortest=0.1), "rest_length": wound}
runs = {
    (hold, name): tc.simulate(
        model,
        duration=4.0,
        nodes=start,
        controller=controller,
        input=hold,
        step=2e-3,
        output_step=0.02,
        **actuators,
    )
    for hold, actuators in (("force_density", {}), ("rest_length", winches))
    for name, controller in controllers.items()
}

# %%
# The error: the largest of a node coordinate, the shape laid over the reference.

wanted = np.array([plant.measure(N, 0 * N)[:9] for N in np.moveaxis(path.nodes, 2, 0)])


def error(run):
    """Return the largest error of a node coordinate at each output, m."""
    q = np.array(
        [
            plant.measure(run.nodes[:, :, k], run.velocities[:, :, k])[:9]
            for k in range(len(run.time))
        ]
    )
    aim = np.column_stack([np.interp(run.time, time, column) for column in wanted.T])
    return np.abs((q - aim) @ plant.basis.T).max(axis=1)


errors = {key: error(run) for key, run in runs.items()}
for (hold, name), off in errors.items():
    moving = off[runs[hold, name].time >= 0.5]
    print(f"{hold:13s} {name:13s} largest {1e3 * moving.max():6.3f} mm, ", end="")
    print(f"at the end {1e3 * off[-25:].max():.3f} mm")

# %%
# Where forces are held, shape control follows closely. What remains is a mechanism of the prism,
# which no string pulls at: the law says so, in m/s², and lets it swing. Where rest
# lengths are held, strings stretch between samples and brake all motion; a law
# without look ahead falls behind.

figure, panels = plt.subplots(2, 1, figsize=(7, 6), sharey=True, layout="constrained")
for panel, hold in zip(panels, ("force_density", "rest_length"), strict=True):
    off = {name: 1e3 * errors[hold, name] for name in controllers}
    tc.plot.history(runs[hold, "MPC"].time, off, "largest node error, mm", ax=panel)
    panel.set_title(f"held between samples: {hold.replace('_', ' ')}", loc="left", pad=24)
    panel.set_yscale("log")
    panel.set_ylim(1e-3, 30)

# %%
# What shape control left of its law, on winches.

left = controllers["shape control"].statistics
print(
    {str(each): n for each, n in left.status_count.items()},
    f"largest residual {left.largest_residual:.3f} m/s²",
)

if __name__ == "__main__":
    plt.show()
