"""How far a linear MPC follows, and what it says of references that are too far.

    python -m tests.benchmarks.reference_distance

Each structure is asked to bring its highest node to a point, nearer and farther, along a path of
equilibria in 2 s, by MPC on the plant at its start; 2 s later the error is read off.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from functools import cache

import numpy as np

import tenscontrol as tc
from tenscontrol.control import ControlWarning
from tenscontrol.control.mpc.linear import law_in_shape
from tenscontrol.simulation import SimulationError

SHARES = (0.02, 0.05, 0.1, 0.2, 0.3, 0.4)  # of the size
DIRECTIONS = {"sideways": [1.0, 0.0, 0.0], "down": [0.3, 0.0, -1.0]}


def structures():
    """Return structures by name, with stiffness, N/m, and prestress, N/m."""
    prism, tower = tc.prism(), tc.prism_tower(stages=2)
    return {
        "prism": (prism, 100.0, 17.3205),
        "stiff prism": (prism, 3000.0, 17.3205),
        "standing prism": (replace(prism, fixed=[3, 4, 5]), 100.0, 17.3205),
        "tower": (tower, 1000.0, 20.0),
        "class-2 tower": (tc.library.class2_tower(), 1000.0, 20.0),
        "planar D-bar": (tc.library.d_bar(), 300.0, 20.0),
        "arm": (tc.library.arm(), 300.0, 20.0),
    }


@cache
def at_start(name):
    """Return the model of a structure, and its prestress."""
    structure, stiffness, level = structures()[name]
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness, damping=0.01 * stiffness))
    return model, tc.prestress(structure, force_density=level)


@cache
def way(name, place, level):
    """Return the path of a structure until its highest node is at a place: of any input."""
    model, rest = at_start(name)
    node = int(model.structure.nodes[-1].argmax())
    there = tc.NodesAt([node], np.array(place)[:, None])
    goal = tc.shape_target(model, there, place="centre", force_density=level)
    return tc.shape_path(model, rest, goal, duration=2.0).reference()


def cases(name, input, shares, ways):
    """Yield direction, share, plant and reference of each distance that a path leads to."""
    model, rest = at_start(name)
    structure, level = model.structure, structures()[name][2]
    plant = tc.linearize(model, rest, input=input)
    d = structure.dimension
    node, size = int(structure.nodes[-1].argmax()), float(np.ptp(structure.nodes, axis=1).max())
    for side in ways:
        sense = DIRECTIONS[side]
        along = np.array(sense)[[0, 2]] if d == 2 else np.array(sense)
        for share in shares:
            place = structure.nodes[:, node] + share * size * along / np.linalg.norm(along)
            yield side, share, plant, way(name, tuple(place.tolist()), level)


def run(plant, reference, **settings):
    """Return whether the controller warned, what it measured, and the error at the end."""
    most = {"max_force_density": 20 * float(plant.force_density.max())}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mpc = tc.MPC(plant, horizon=12, sample_time=0.02, reference=reference, **most, **settings)
    warned = [str(each.message) for each in told if each.category is ControlWarning]
    size = float(np.ptp(plant.nodes, axis=1).max())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = tc.simulate(
                plant.model, 4.0, plant.nodes, controller=mpc, input=plant.input, output_step=0.02
            )
        error = float(found.control.tracking_error[-50:].max()) / size
    except SimulationError:
        error = np.inf
    return mpc, warned, error


def main(arguments=None):
    """Print a row for each structure, input, direction and distance."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(structures()))
    parser.add_argument("--shares", nargs="+", type=float, default=SHARES, metavar="PART")
    parser.add_argument("--ways", nargs="+", choices=DIRECTIONS, default=list(DIRECTIONS))
    given = parser.parse_args(arguments)
    print(
        "structure        input          way       distance   growth/s  offset   error     warned"
    )
    for name in given.names:
        for input in ("rest_length", "force_density"):
            try:
                for side, share, plant, reference in cases(name, input, given.shares, given.ways):
                    mpc, warned, error = run(plant, reference)
                    path = mpc.law.path
                    growth, offset = law_in_shape(plant, mpc.law.design, path, path.span[1])
                    offset /= float(np.ptp(plant.nodes, axis=1).max())
                    print(
                        f"{name:16s} {input:14s} {side:9s} {100 * share:5.0f} % "
                        f"{growth:10.2g} {100 * offset:8.2g} % {100 * error:8.2g} %  "
                        f"{'yes' if warned else 'no'}", flush=True,
                    )  # fmt: skip
            except (tc.shape.ShapeError, tc.shape.PathError, ValueError) as error:
                print(f"{name:16s} {input:14s} ends: {str(error)[:90]}", flush=True)


if __name__ == "__main__":
    main()
