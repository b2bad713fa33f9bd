"""
A six-bar ball, and a mode that no string reaches
=================================================

The six-bar ball is the best known tensegrity robot. One of its modes changes no string's length,
to first order, and its only state of self-stress cannot steer that mode. Controllers say so, leave
it alone and control all others. On three fixed nodes every mode can be reached.
"""

import warnings
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

import tenscontrol as tc

SAMPLE, STIFFNESS, PRESTRESS = 0.02, 1000.0, 20.0  # s, N/m, N/m
AWAY, MOVE = 0.05, 0.1  # of the size, m
FACE, NODE = [8, 4, 0], 3  # a triangle of strings, and the node that is to move

ball = tc.library.six_bar_ball(bar_length=1.0)
balls = {"free": ball, "on three nodes": replace(ball, fixed=FACE)}


def plant_of(structure):
    """Return the plant of a ball, commanded by rest lengths."""
    model = tc.Model(structure, strings=tc.LinearStrings(STIFFNESS))
    return tc.linearize(
        model, tc.prestress(structure, force_density=PRESTRESS), input="rest_length"
    )


plants = {name: plant_of(structure) for name, structure in balls.items()}
for name, plant in plants.items():
    found = tc.controllability(plant)
    print(f"{name}: {found.unreachable} of {len(plant.A)} states out of reach")
    print(found.unreached.table())

# %%
# Back from a disturbance
# -----------------------
#
# All nodes are off by up to 5 % of the size. The mode out of reach is named in a warning.


def off(plant):
    """Return a shape with nodes up to 5 % of the size away."""
    q = np.random.default_rng(0).normal(size=plant.degrees_of_freedom)
    moved = np.linalg.norm((plant.basis @ q).reshape(-1, 3), axis=1).max()
    return plant.to_nodes(AWAY * np.ptp(plant.nodes, axis=1).max() / moved * q)


def parts(plant, run, alone):
    """Return the size of q over a run, of what is controlled and of what is left alone, in mm."""
    r, states = plant.degrees_of_freedom, zip(run.nodes.T, run.velocities.T, strict=True)
    q = np.array([plant.measure(nodes.T, speeds.T)[:r] for nodes, speeds in states])
    shapes = alone.shape.real.swapaxes(0, 1).reshape(plant.nodes.size, len(alone))
    own = np.linalg.qr(plant.coordinates.project(shapes))[0] if len(alone) else np.zeros((r, 0))
    rest = q - q @ own @ own.T
    return [1e3 * np.linalg.norm(plant.basis @ part.T, axis=0) for part in (rest, q @ own @ own.T)]


returns, left_alone = {}, {}
for name, plant in plants.items():
    with warnings.catch_warnings(record=True, action="always") as caught:
        controllers = {
            "LQR": tc.LQR(plant, sample_time=SAMPLE),
            "MPC": tc.MPC(plant, horizon=10, sample_time=SAMPLE),
            "NMPC": tc.NMPC(plant, horizon=5, sample_time=SAMPLE),
        }
    if caught:
        print(caught[0].message)
    for kind, law in controllers.items():
        run = tc.simulate(
            plant.model, 0.8, off(plant), controller=law, step=2e-3, output_step=SAMPLE
        )
        controlled, alone = returns[name, kind] = parts(plant, run, law.left_alone)
        left_alone[name] = law.left_alone
        print(
            f"{name}, {kind}: {controlled[0]:.1f} to {controlled[-1]:.4f} mm controlled, "
            f"{alone[0]:.1f} to at most {alone.max():.1f} mm left alone"
        )

# %%
# A node moves by 10 cm
# ---------------------
#
# Relative to a face of the ball, along a path of shapes in balance. Strings stay taut.


def seen_from_face(nodes, reference):
    """Return the place of the node after the face is laid over where it was."""
    face, before = nodes[:, FACE], reference[:, FACE]
    middle, before_middle = face.mean(axis=1), before.mean(axis=1)
    turn, _ = Rotation.align_vectors((before.T - before_middle), face.T - middle)
    return turn.apply(nodes[:, NODE] - middle) + before_middle


moves = {}
for name, plant in plants.items():
    model, nodes = plant.model, plant.nodes
    wanted = nodes[:, [NODE]] + [[0.0], [MOVE], [0.0]]
    demands = [tc.NodesAt([NODE], wanted)]
    if name == "free":
        demands.append(tc.NodesAt(FACE, nodes[:, FACE]))
    goal = tc.shape_target(model, demands, min_force_density=5.0, max_force_density=60.0)
    start = tc.prestress(model.structure, force_density=PRESTRESS)
    path = tc.shape_path(model, start, goal, duration=0.8)
    # The warning is known.
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        controllers = {
            "MPC": tc.MPC(plant, horizon=10, sample_time=SAMPLE, reference=path.reference()),
            "NMPC": tc.NMPC(plant, horizon=5, sample_time=SAMPLE, reference=path.reference()),
        }
    for kind, law in controllers.items():
        run = tc.simulate(model, 1.2, nodes, controller=law, step=2e-3, output_step=SAMPLE)
        # Where the node is, seen from the face.
        seen = [seen_from_face(each.T, nodes) for each in run.nodes.T]
        moves[name, kind] = np.array(seen) - nodes[:, NODE]
        off_goal = np.linalg.norm(moves[name, kind][-1] - [0.0, MOVE, 0.0])
        print(f"{name}, {kind}: node {1e3 * off_goal:.1f} mm off its goal, "
              f"{run.control.status_count}")  # fmt: skip

# %%
# The mode that is left alone, what becomes of the disturbance, and the moved node.

lost = left_alone["free"]
figure = plt.figure(figsize=(8.5, 7.5), layout="constrained")
grid = figure.add_gridspec(2, 2)
tc.plot.mode_shapes(plants["free"], lost, axes=[figure.add_subplot(grid[0, 0], projection="3d")])
time = SAMPLE * np.arange(len(returns["free", "LQR"][0]))
curves = {kind: returns["free", kind][0] for kind in ("LQR", "MPC", "NMPC")}
curves["left alone, LQR"] = returns["free", "LQR"][1]
tc.plot.history(time, curves, "free ball, √(Σ|δn|²), mm", ax=figure.add_subplot(grid[0, 1]))
for column, name in enumerate(balls):
    curves = {kind: 1e3 * moves[name, kind][:, 1] for kind in ("MPC", "NMPC")}
    late = SAMPLE * np.arange(len(curves["MPC"]))
    ax = figure.add_subplot(grid[1, column])
    tc.plot.history(late, curves, f"ball {name}: node {NODE} along y, mm", ax=ax)

# %%
# The ball on three nodes after its move, over the shape at the start.

# sphinx_gallery_thumbnail_number = 2
drawing = tc.plot.structure(balls["on three nodes"], faint=True)
tc.plot.structure(run, ax=drawing.ax)

if __name__ == "__main__":
    plt.show()
