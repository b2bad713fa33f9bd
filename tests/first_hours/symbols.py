"""The prism in one's own program, and in python-control and back."""

import casadi as ca
import control
import numpy as np

import tenscontrol as tc

# %% symbols
prism = tc.prism()
model = tc.Model(prism)
s = model.symbolic()  # the paper's names: N, Nd, Ndd, gamma, lam, M_s, K_s, W
slope = ca.vertcat(ca.vec(s.Nd), ca.vec(s.Ndd))
motion = ca.Function("motion", [s.x, s.gamma], [slope])
rest = tc.prestress(prism, force_density=10.0)
plant = tc.linearize(model, rest)

# %% program
SAMPLES, TIME = 10, 0.05  # s a sample, in which the force densities are held
x, gamma = ca.SX.sym("x", 36), ca.SX.sym("gamma", 9)
end, h = x, TIME / 2
for _ in range(2):  # steps of RK4 in a sample
    k1 = motion(end, gamma)
    k2 = motion(end + h / 2 * k1, gamma)
    k3 = motion(end + h / 2 * k2, gamma)
    k4 = motion(end + h * k3, gamma)
    end += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
sample = ca.Function("sample", [x, gamma], [end])

push = plant.to_velocities(np.zeros(9), 0.3 * np.eye(9)[4])  # m/s, keeps bar lengths
start = np.r_[prism.nodes.T.ravel(), push.T.ravel()]
home = np.r_[prism.nodes.T.ravel(), np.zeros(18)]

opti = ca.Opti()
states, held = opti.variable(36, SAMPLES + 1), opti.variable(9, SAMPLES)
opti.subject_to(states[:, 0] == start)
opti.subject_to(states[:, 1:] == sample.map(SAMPLES)(states[:, :-1], held))
opti.subject_to(opti.bounded(0.0, held, 40.0))  # N/m
# Bars leave fewer motions than coordinates: the end is a cost and no constraint.
opti.minimize(1e4 * ca.sumsqr(states[:, -1] - home) + 1e-3 * ca.sumsqr(held - 10.0))
opti.set_initial(states, np.tile(home[:, None], SAMPLES + 1))
opti.set_initial(held, np.tile(rest.force_density[:, None], SAMPLES))
opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
planned = opti.solve().value(held)

# %% play
times = TIME * np.arange(SAMPLES + 1)
profile = tc.Profile(times[:-1], planned, "hold")
played = tc.simulate(model, times[-1], velocities=push, force_density=profile)
free = tc.simulate(model, times[-1], velocities=push, force_density=rest)
for name, run in {"left alone": free, "planned": played}.items():
    off = 1e3 * np.linalg.norm(run.nodes[..., -1] - prism.nodes, axis=0).max()
    speed = np.abs(run.velocities[..., -1]).max()
    print(f"{name}: {off:.2f} mm from rest, at {speed:.3f} m/s")

tc.plot.trajectory(played)

# %% there
system = plant.to_statespace(0.02, outputs="state")  # a control.StateSpace
Q, R = tc.energy_weights(plant)
R = 0.01 * R  # more work, less swing
gain, _, poles = control.dlqr(system, Q, np.diag(R))
print("slowest pole of the loop:", np.abs(poles).max().round(4))

# %% back
feedback = control.ss([], [], [], -gain, 0.02)
law = tc.control.LinearController(plant, feedback, sees="state")
run = tc.simulate(model, 2.0, velocities=push, controller=law, step=2e-3)
off = 1e3 * np.linalg.norm(run.nodes - prism.nodes[..., None], axis=0).max(axis=0)
print(f"{off.max():.1f} mm at most, {off[-1]:.2f} mm in the end")
lqr = tc.LQR(plant, Q, R, sample_time=0.02)
loop = control.feedback(system, lqr.to_statespace(), sign=1)
print("with our LQR:", np.abs(loop.poles()).max().round(4))
