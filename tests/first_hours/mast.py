"""From connectivity matrices to a sized, controlled mast."""

import numpy as np

import tenscontrol as tc

# %% matrices
STAGES, HEIGHT, RADIUS, PAYLOAD = 4, 2.0, 0.2, 2.0  # m, m, kg
angle = 2 * np.pi * np.arange(3) / 3
ring = RADIUS * np.array([np.cos(angle), np.sin(angle)])
levels = np.linspace(0.0, HEIGHT, STAGES + 1)
N = np.hstack([np.vstack([ring, np.full(3, level)]) for level in levels])  # 3 × 15

bar_ends, string_ends = [], []  # counted from 1, as in MATLAB
for first in range(1, 3 * STAGES + 1, 3):
    for k in range(3):
        one, other = first + k, first + (k + 1) % 3
        bar_ends += [(one, one + 3), (one + 3, other + 3)]  # longeron, batten
        string_ends += [(one, other + 3), (other, one + 3)]  # crossed on each face


def connectivity(ends):
    """Return C, one row a member: what tenseg_ind2C returns."""
    C = np.zeros((len(ends), N.shape[1]))
    for row, (begin, end) in enumerate(ends):
        C[row, begin - 1], C[row, end - 1] = -1.0, 1.0
    return C


C_b, C_s = connectivity(bar_ends), connectivity(string_ends)

# %% structure
base, top = [0, 1, 2], [12, 13, 14]
payload = np.zeros(N.shape[1])
payload[top] = PAYLOAD / 3
mast = tc.Structure.from_matrices(
    N, C_b, C_s, bar_mass=1.0, fixed=base, point_mass=payload,
)  # fmt: skip
print(mast, "class", mast.structure_class)

# %% size
loads = []
for side in np.deg2rad([0, 60, 120, 180, 240, 300]):
    load = np.zeros(N.shape)
    force = np.array([30 * np.cos(side), 30 * np.sin(side), -100.0])  # N
    load[:, top] = force[:, None] / 3
    loads.append(load)
sized = tc.design(
    mast,
    bars=tc.sizing.materials["carbon tube"],
    strings=tc.sizing.materials["dyneema"],
    loads=loads,
    safety=2.0,
    tube=tc.sizing.Tube(0.85),
    min_force_density=50.0,  # N/m: every string is taut under every load
    groups=tc.sizing.length_groups(mast),  # longerons, battens, one rope
)
print(sized)

# %% modes
strings = tc.ElasticStrings(sized.axial_rigidity, damping=2.0)
model = tc.Model(sized.structure, strings, external_force=True)
rest = tc.prestress(sized.structure, min_force_density=50.0)
motors = range(6)  # on the strings of the lowest stage; all others are wound once
plant = tc.linearize(model, rest, input="rest_length", actuated=motors)
print(tc.modes(plant).frequency[:3].round(1), "Hz")

# %% control
lqr = tc.LQR(plant, *tc.energy_weights(plant), sample_time=0.01)
push = np.zeros((*N.shape, 4))
push[0, top, 1:3] = 10.0 / 3  # N, along x
gust = tc.Profile([0.0, 0.05, 0.2, 0.25], push)
scene = {"rest_length": plant.rest_length, "external_force": gust}
scene["output_step"] = 0.01
held = tc.simulate(model, 1.5, **scene)
still = tc.simulate(model, 1.5, controller=lqr, **scene)
runs = {"strings held": held, "LQR": still}
sway = {name: 1e3 * run.nodes[0, top].mean(axis=0) for name, run in runs.items()}
for name, top_x in sway.items():
    late = np.abs(top_x[still.time > 1.0]).max()
    print(f"{name}: {np.abs(top_x).max():.1f} mm at most, {late:.2f} mm after 1 s")
tc.plot.history(still.time, sway, "top along x, mm")

# %% strength
margins = tc.strength(still, sized)
print(margins)
tc.plot.utilization(margins)
