"""Equilibria of random structures: bars and strings anywhere, soft beside stiff, taut and slack.

``python -m tests.plant.equilibria --count 400`` runs a campaign, and prints what became of it; with
``--any`` on structures of any class, in space and in the plane. The ordinary suite runs the seeds
of ``test_equilibrium.py``.
"""

import argparse
import warnings
from collections import Counter
from itertools import combinations

import numpy as np

import tenscontrol as tc
from tests.statics.structures import random_any


def random_rest(seed):
    """A model and what holds it, as arguments of ``tc.equilibrium``; None where there is none."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 5))
    bars = np.arange(2 * count).reshape(-1, 2)
    pairs = [pair for pair in combinations(range(2 * count), 2) if pair[0] // 2 != pair[1] // 2]
    strings = [pair for pair in pairs if rng.random() < 0.7]
    if len(strings) < 3:
        return None
    fixed = rng.choice(2 * count, int(rng.integers(0, 3)), replace=False)
    nodes = rng.uniform(-1, 1, (3, 2 * count))
    structure = tc.Structure(nodes, bars, strings, rng.uniform(0.1, 2, count), fixed=fixed.tolist())
    stiffness = 10 ** rng.uniform(0, rng.choice([4, 9]), len(strings))
    gravity = 9.81 if len(fixed) and rng.random() < 0.5 else 0.0
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness), gravity=gravity)
    longest = 1.5 if rng.random() < 0.4 else 1.0
    wound = structure.string_length() * rng.uniform(0.5, longest, len(strings))
    return {"model": model, "rest_length": wound}


def random_rest_of_any(seed):
    """The same for a structure with shared nodes, rollers, payloads and a clustered string."""
    rng = np.random.default_rng(seed)
    structure = random_any(seed)
    count = len(structure.strings)
    stiffness = 10 ** rng.uniform(1, rng.choice([3, 6]), count)
    gravity = 9.81 if len(structure.fixed) and rng.random() < 0.5 else None
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness), gravity=gravity)
    wound = structure.string_length() * rng.uniform(0.5, rng.choice([1.0, 1.5]), count)
    return {"model": model, "rest_length": wound}


def main():
    """Run a campaign."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--any", action="store_true")
    given = parser.parse_args()
    draw = random_rest_of_any if given.any else random_rest
    warnings.simplefilter("ignore")  # of slack strings and of bars that cross
    found = Counter()
    for seed in range(given.start, given.start + given.count):
        case = draw(seed)
        if case is None:
            found["no case"] += 1
            continue
        try:
            tc.equilibrium(**case)
            found["at rest"] += 1
        except ValueError as error:
            found[str(error).partition(":")[0]] += 1
            print(seed, error)
    print(dict(found))


if __name__ == "__main__":
    main()
