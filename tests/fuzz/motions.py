"""Odd calls of ``optimal_motion``: wrong values, and right ones that do not go together.

``python -m tests.fuzz.motions --count 500`` draws as many calls from a seed, each with one or two
oddities, prints what is neither a result nor an error of ours that names the argument, and counts.
``--only NUMBER`` makes one call and prints what came of it.
"""

from __future__ import annotations

import argparse
import collections
import sys
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np

import tenscontrol as tc
from tests.fuzz.arguments import OUTCOMES, judged

NAN, INF, OWN = float("nan"), float("inf"), "raised by a function of the user"
NUMBERS = (NAN, INF, -INF, 0, -1.0, 1e-300, 1e-12, 1e12, 1e300, "1", None, [], True, 1j, 0.5, 3)


SCENES = {"arm": 500.0, "kite": 500.0, "prism": 100.0}  # stiffness of the strings, N/m


@cache
def scene_of(name):
    """Model, start, goal and another equilibrium of a small structure."""
    structure = getattr(tc.library, name)()
    model = tc.Model(structure, tc.LinearStrings(SCENES[name], damping=1.0))
    start = tc.prestress(structure, min_force_density=10.0)
    node = structure.free[-1]
    goal = tc.shape_target(
        model, tc.NodesAt([node], structure.nodes[:, [node]] + 0.02), place="centre",
        min_force_density=1.0, force_density=float(start.force_density[0]), start=structure.nodes,
    )  # fmt: skip
    return model, start, goal, tc.prestress(structure, min_force_density=20.0)


def _any(name, values=NUMBERS):
    return [(name,), lambda scene, draw: {name: draw(values)}]


def _of_strings(name):
    """Arrays of the wrong length or shape, or with one wrong entry."""

    def made(scene, draw):
        count = len(scene[0].structure.strings)
        one = np.full(count, 50.0)
        one[-1] = draw((NAN, -INF, -1.0, 0.0, 1e300))
        wrong = np.ones(count + 1), np.ones((count, 1)), np.full(count, "x"), np.ones((2, 2, 2))
        return {name: draw((one, *wrong))}

    return [(name,), made]


def _turned(scene):
    start = scene[1]
    c, s = np.cos(0.3), np.sin(0.3)
    turn = np.eye(start.structure.dimension)
    turn[:2, :2] = [[c, -s], [s, c]]
    structure = replace(start.structure, nodes=turn @ start.structure.nodes)
    return tc.prestress(structure, start.force_density)


def _raises(*_):
    raise KeyError(OWN)


def _far(scene, draw):
    structure = scene[0].structure
    node = structure.free[-1]
    way = draw((1e-12, 0.3, 1.0, 10.0, 1e6)) * structure.size
    return {"goal": tc.NodesAt([node], structure.nodes[:, [node]] + way)}


def _plant(scene, draw):
    model, start, goal, other = scene
    at = draw((start, other, goal.prestress))
    chosen = draw((None, [0], [0, 1], {"drum": [0, 1]}, {"drum": {0: 1.0, 1: -1.0}}))
    kind = draw(("rest_length", "force_density"))
    return {"plant": tc.linearize(model, at, input=kind, actuated=chosen)}


def _other_plant(scene, draw):
    name = draw([name for name in SCENES if scene_of(name) is not scene])
    model, start, *_ = scene_of(name)
    return {"plant": tc.linearize(model, start, input=draw(("rest_length", "force_density")))}


def _motors(scene, draw):
    torque = draw((None, 1e-9, 0.1, 1e9))
    motor = tc.Motor(
        0.01, gear_ratio=draw((1.0, 10.0)), torque=torque, speed=draw((None, 1e-6, 800.0)),
        inertia=draw((0.0, 0.0, 1e-12, 3e-5, 1e6)) if torque else 0.0,
        lag=draw((0.0, 0.0, 0.1)), backlash=draw((0.0, 0.0, 1e-3)),
    )  # fmt: skip
    return {"winches": tc.Winches(motor=motor)}


def _winches(scene, draw):
    count = len(scene[0].structure.strings)
    return {
        "winches": draw((
            tc.Winches(rate=1e-9), tc.Winches(rate=1e9), tc.Winches(rate=np.ones(count + 1)),
            tc.Winches(shortest=5.0), tc.Winches(longest=0.01), tc.Winches(rate=1.0, substeps=3),
            tc.Winches(shortest=np.full(count + 2, 0.1)), tc.Winches(), tc.Motor(0.01), 0.5, "fast",
        ))
    }  # fmt: skip


def _models(scene, draw):
    model, structure = scene[0], scene[0].structure
    ground = tc.Ground(stiffness=1e4)
    return {
        "model": draw((
            tc.Model(structure), structure, None, "arm",
            tc.Model(structure, model.strings, gravity=9.81),
            tc.Model(structure, tc.LinearStrings(1e9)), tc.Model(structure, tc.LinearStrings(1e-6)),
            tc.Model(structure, model.strings, ground=ground),
            tc.Model(structure, tc.ElasticStrings(100.0)),
        ))
    }  # fmt: skip


def _obstacles(scene, draw):
    return {
        "obstacles": draw((
            _raises, lambda: 0, lambda a, b: a, lambda nodes: None, lambda nodes: -1.0,
            lambda nodes: ca.SX(NAN), lambda nodes: ca.sqrt(-1 - nodes[0, 0] ** 2),
            lambda nodes: nodes, lambda nodes: [], lambda nodes: np.ones(3), lambda nodes: 1.0,
            lambda nodes: -nodes[0, -1] ** 2 - 1, lambda nodes: INF,
            lambda nodes: ca.MX.sym("x"), lambda nodes: nodes > 0, lambda nodes: [1.0, None],
            lambda nodes: ca.norm_2(nodes[:, -1] - nodes[:, -1]) - 1.0, "away", ca.SX(1),
        ))
    }  # fmt: skip


def _costs(scene, draw):
    return {
        "minimize": draw((
            _raises, lambda: 0, lambda nodes: 1, lambda n, v, u, r: n, lambda n, v, u, r: None,
            lambda n, v, u, r: NAN, lambda n, v, u, r: -1.0, lambda n, v, u, r: 0.0,
            lambda n, v, u, r: ca.log(-1 - ca.sumsqr(n)), lambda n, v, u, r: 1e300,
            lambda n, v, u, r: -ca.sumsqr(v), lambda n, v, u, r: ca.MX(1), "speed", 1, ["time"],
            lambda n, v, u, r: ca.sqrt(ca.sumsqr(v)),
        ))
    }  # fmt: skip


def _timed(scene, draw):
    return {"minimize": draw(("energy", "effort", "time")), "duration": draw((*NUMBERS, 0.3))}


# Names that an error may use, and a function of scene and draw that gives arguments.
ODDITIES = [
    *[_any(name) for name in (
        "duration", "min_force_density", "max_force_density", "max_tension", "max_power",
        "min_clearance", "intervals", "tolerance", "cost_tolerance", "refinements",
        "most_iterations", "start", "goal", "plant", "obstacles", "winches", "input", "model",
    )],
    *[_of_strings(name) for name in
      ("min_force_density", "max_force_density", "max_tension", "max_power")],
    _any("input", ("force_density", "rest_length", "tension", 0, b"x")),
    _any("min_force_density", (9.99, 11.0, 1e3)),
    _any("max_force_density", (9.0, 11.0, 1e-3, 30.0)),
    _any("max_tension", (1.0, 10.0, 20.0, 50.0)),
    _any("max_power", (1e-9, 1e-3, 1.0, 1e12)),
    _any("min_clearance", (1e-9, 0.05, 0.4, 50.0)),
    _any("intervals", (1, 2, 3, 10**9, 4.0, 2.5, np.int64(4))),
    _any("refinements", (-1, 0, 1.5, 11)),
    [("goal", "start"), lambda scene, draw: {"goal": draw((scene[1], scene[3], _turned(scene)))}],
    [("start", "goal"), lambda scene, draw: {"start": draw((scene[2], scene[2].nodes, scene[0]))}],
    [("start",), lambda scene, draw: {"start": scene_of(draw([*SCENES]))[1]}],
    [("goal", "demand"), _far],
    [("plant", "input", "goal", "start", "actuated"), _plant],
    [("plant", "model"), _other_plant],
    [("winches", "motor", "motors", "torque of the motors"), _motors],
    [("winches", "start", "goal"), _winches],
    [("model", "ground", "start"), _models],
    [("obstacles",), _obstacles],
    [("minimize",), _costs],
    [("duration", "minimize"), _timed],
    [("maximize",), lambda scene, draw: {draw(("maximize", "Duration", "")): 1.0}],
]  # fmt: skip


def odd_call(number, seed=0, scenes=tuple(SCENES)):
    """Return arguments of a call and the names that an error of it may use."""
    random = np.random.default_rng([seed, number])

    def draw(values):
        return values[int(random.integers(len(values)))]

    scene = scene_of(draw(scenes))
    given = {
        "model": scene[0], "start": scene[1], "goal": scene[2], "winches": tc.Winches(rate=1.0),
        "intervals": 5, "refinements": 0, "most_iterations": 20, "tolerance": 0.1,
    }  # fmt: skip
    names = set()
    for _ in range(draw((1, 1, 2))):
        may_name, made = draw(ODDITIES)
        odd = made(scene, draw)
        given |= odd
        names |= {*may_name, *odd}
    return given, sorted(names)


def plan(**given):
    """Plan, and return numbers of what was planned, which are finite; none if the plan says why."""
    motion = tc.optimal_motion(**given)
    if motion.run is None:
        if not motion.message or str(motion.status) == "ok":
            raise AssertionError(f"nothing was planned, and {motion!r} does not say why")
        return ()
    return motion.cost, motion.duration, motion.goal_miss, motion.end_speed, motion.nodes


def outcome_of(number, seed=0, scenes=tuple(SCENES)):
    """Make a call: (outcome, what was found)."""
    given, names = odd_call(number, seed, scenes)
    outcome = judged(plan, given, names, "optimal_motion")
    if "unexpected keyword argument" in outcome[1] or OWN in outcome[1]:  # Python's, the user's
        return "clear error", outcome[1]
    return outcome


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="one call, with what came of it")
    given = parser.parse_args()
    if given.only is not None:
        print(odd_call(given.only, given.seed), *outcome_of(given.only, given.seed), sep="\n")
        return 0
    counts = collections.Counter()
    for number in range(given.count):
        outcome, text = outcome_of(number, given.seed)
        counts[outcome] += 1
        if outcome not in OUTCOMES[:2]:
            print(f"{outcome} --only {number}: {text}", flush=True)
    print(dict(counts))
    return int(any(outcome in OUTCOMES[2:] for outcome in counts))


if __name__ == "__main__":
    sys.exit(main())
