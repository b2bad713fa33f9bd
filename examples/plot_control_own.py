"""
Controllers of your own
=======================

Use your own controller in place of ours. Four examples: PD on string lengths, an LQR of
python-control, an MPC written in ``casadi.Opti``, and a small neural network that imitates an LQR.
A controller is a function of time, nodes and velocities, or an object with a method ``command``.
The structures are a six-bar ball on three fixed nodes and a class-2 tower.
"""

from dataclasses import replace

import casadi as ca
import control
import matplotlib.pyplot as plt
import numpy as np

import tenscontrol as tc

LAW = tc.LinearStrings(stiffness=1000.0, damping=0.5)
DURATION, OFF = 1.0, 0.05  # s, m


def pushed(plant, seed):
    """Return a shape whose farthest node is off by 5 cm, with exact bar lengths."""
    q = np.random.default_rng(seed).normal(size=plant.degrees_of_freedom)
    moves = (plant.basis @ q).reshape(-1, 3)
    return plant.to_nodes(OFF * q / np.linalg.norm(moves, axis=1).max())


ball = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
ball = replace(ball, fixed=np.argsort(ball.nodes[2])[:3])
model = tc.Model(ball, strings=LAW)
plant = tc.linearize(model, tc.prestress(ball, min_force_density=50.0), input="rest_length")
still = plant.rest_length
start = pushed(plant, seed=1)

# %%
# A PD law on string lengths. A function that is given as ``controller`` commands what the actuators
# hold: rest lengths here.

wanted = ball.string_length(ball.nodes)


def pd(time, nodes, velocities):
    """Wind in a string that is too long or grows."""
    strings, rates = ball.string_vectors(nodes), ball.string_vectors(velocities)
    length = np.linalg.norm(strings, axis=0)
    rate = (strings * rates).sum(axis=0) / length
    return still - 0.1 * (length - wanted) - 0.005 * rate


runs = {
    "PD on string lengths": tc.simulate(
        model, DURATION, start, controller=pd, sample_time=0.005, rest_length=still, step=1e-3
    )
}

# %%
# An LQR of python-control. Its gain is that of :class:`tenscontrol.LQR`.

Q, R = tc.energy_weights(plant)
gain, _, _ = control.lqr(plant.to_statespace(), Q, np.diag(R))


def lqr_of_control(time, nodes, velocities):
    """Feed back the reduced state, which the plant measures."""
    return still - gain @ plant.measure(nodes, velocities)


limited = tc.FunctionController(
    ball, lqr_of_control, input="rest_length", sample_time=0.005, max_change=0.02
)
runs["LQR of python-control"] = tc.simulate(
    model, DURATION, start, controller=limited, rest_length=still, step=1e-3
)

# %%
# An MPC in ``casadi.Opti``, built once and solved at each sample. It must know which rest lengths
# the winches have reached, so it is an object: ``applied`` is told. Where OSQP fails it returns
# NaN, and the previous rest lengths are held.

tower = tc.library.class2_tower()
tall = tc.Model(tower, strings=LAW)
tower_plant = tc.linearize(tall, tc.prestress(tower, min_force_density=50.0), input="rest_length")
tower_still, tower_start = tower_plant.rest_length, pushed(tower_plant, seed=1)
regulator = tc.LQR(tower_plant, sample_time=0.02)


class OptiMPC:
    """Linear MPC whose rest lengths change by at most 1 cm a sample."""

    input, sample_time = "rest_length", 0.02

    def __init__(self, plant, horizon):
        A, B, _ = plant.discretize(self.sample_time)
        Q, R = tc.energy_weights(plant, by_mode=True)  # those of the regulator
        opti = ca.Opti("conic")
        Z, V = opti.variable(len(A), horizon + 1), opti.variable(B.shape[1], horizon)
        state, previous = opti.parameter(len(A)), opti.parameter(B.shape[1])
        cost = ca.bilin(regulator.cost, Z[:, -1])
        opti.subject_to(Z[:, 0] == state)
        for k in range(horizon):
            cost += ca.bilin(Q, Z[:, k]) + ca.dot(R, V[:, k] ** 2)
            opti.subject_to(Z[:, k + 1] == A @ Z[:, k] + B @ V[:, k])
            before = V[:, k - 1] if k else previous
            opti.subject_to(opti.bounded(-0.01, V[:, k] - before, 0.01))
        opti.minimize(cost)
        opti.solver("osqp", {"print_time": False, "osqp": {"verbose": False}})
        self.plant, self.opti = plant, opti
        self.symbols = state, previous, V[:, 0]
        self.reached = plant.rest_length

    def applied(self, value):
        """Remember the rest lengths that the winches have reached."""
        self.reached = value

    def command(self, time, nodes, velocities):
        """Return the first rest lengths of the plan."""
        state, previous, first = self.symbols
        self.opti.set_value(state, self.plant.measure(nodes, velocities))
        self.opti.set_value(previous, self.reached - self.plant.rest_length)
        try:
            return self.plant.rest_length + self.opti.solve().value(first)
        except RuntimeError:
            return np.full(len(self.reached), np.nan)


tower_runs = {
    "MPC by casadi.Opti": tc.simulate(
        tall,
        DURATION,
        tower_start,
        controller=OptiMPC(tower_plant, horizon=8),
        rest_length=tower_still,
        step=1e-3,
    )
}

# %%
# A policy network as a plain function: 200 hidden units with random weights, whose output weights
# are fitted by least squares to the commands of an LQR along six of its own runs. That is
# behaviour cloning, the plainest way to a policy: it knows what the LQR does near those runs, and
# nothing beyond. Its start is another than theirs.

random = np.random.default_rng(0)


def inputs(nodes, velocities):
    """Return what the network sees, of order one: shape (k,), or (k, T) of a motion."""
    moved = nodes - tower.nodes.reshape(3, -1, *[1] * (nodes.ndim - 2))
    seen = np.stack([moved / OFF, velocities])[:, :, tower.free]
    return seen.reshape(-1, *nodes.shape[2:])


def taught(seeds):
    """Return inputs, shape (k, T), and commands, (α, T), of runs of the LQR."""
    seen, told = [], []
    for seed in seeds:
        run = tc.simulate(
            tall,
            DURATION,
            pushed(tower_plant, seed),
            controller=regulator,
            rest_length=tower_still,
            step=1e-3,
        )
        N, V = run.nodes[:, :, ::5], run.velocities[:, :, ::5]
        seen.append(inputs(N, V))
        told += [regulator.command(0.0, N[..., k], V[..., k]).value for k in range(N.shape[2])]
    return np.hstack(seen), np.array(told).T - tower_still[:, None]


seen, told = taught(range(10, 16))
hidden = 0.3 * random.normal(size=(200, len(seen))) / np.sqrt(len(seen))
shift = random.uniform(-1.0, 1.0, size=(200, 1))
layer = np.vstack([np.tanh(hidden @ seen + shift), np.ones(seen.shape[1])])
output = np.linalg.solve(layer @ layer.T + 1e-6 * np.eye(len(layer)), layer @ told.T).T
misfit = np.linalg.norm(output @ layer - told) / np.linalg.norm(told)


def network(time, nodes, velocities):
    """Return what the LQR would command, nearly."""
    unit = np.tanh(hidden @ inputs(nodes, velocities) + shift[:, 0])
    return tower_still + output @ np.append(unit, 1.0)


tower_runs["network"] = tc.simulate(
    tall,
    DURATION,
    tower_start,
    controller=network,
    sample_time=0.02,
    rest_length=tower_still,
    step=1e-3,
)

# %%
# The record of a run says which controller it was and how its samples went.

for run in (*runs.values(), *tower_runs.values()):
    print(run.control.controller, run.control.status_count)
print(f"the network misses {misfit:.2%} of the commands that it was taught")

# %%
# Distance of the farthest node from its place: six-bar ball on three nodes, and tower of class 2,
# with the LQR that the network imitates.

runs["rest lengths held"] = tc.simulate(model, DURATION, start, rest_length=still, step=1e-3)
tower_runs["the LQR it imitates"] = tc.simulate(
    tall, DURATION, tower_start, controller=regulator, rest_length=tower_still, step=1e-3
)
tower_runs["rest lengths held"] = tc.simulate(
    tall, DURATION, tower_start, rest_length=tower_still, step=1e-3
)
figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
errors = []
for ax, name, structure, found in (
    (axes[0], "ball", ball, runs),
    (axes[1], "tower", tower, tower_runs),
):
    off = {
        each: np.linalg.norm(run.nodes - structure.nodes[:, :, None], axis=0).max(axis=0)
        for each, run in found.items()
    }
    errors.append(off)
    curves = {each: 1e3 * error for each, error in off.items()}
    time = found["rest lengths held"].time
    tc.plot.history(time, curves, f"{name}: farthest node, mm", ax=ax)
    ax.set_yscale("log")
    ax.set_ylim(0.01, 100)

# %%
# The two structures at the start, over their shapes at rest.

# sphinx_gallery_thumbnail_number = 2
figure = plt.figure(figsize=(8.0, 4.0), layout="constrained")
for column, (structure, nodes) in enumerate(((ball, start), (tower, tower_start))):
    ax = figure.add_subplot(1, 2, column + 1, projection="3d")
    tc.plot.structure(structure, ax=ax, faint=True)
    tc.plot.structure(structure, nodes, ax=ax, legend=False)
    ax.set_axis_off()

if __name__ == "__main__":
    plt.show()
