"""Designs on random stable structures: what strings reach, the regulator, and its nonlinear loop.

``python -m tests.control.reached --count 200`` runs a campaign on structures of 2 to 12 bars, class
1 to 4, free and supported, one in three with a threefold symmetry, and prints what became of it.
The ordinary suite runs a few seeds (``test_reached.py``).
"""

import argparse
import warnings
from collections import Counter
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import tenscontrol as tc
from tenscontrol.plant.controllability import reached_states
from tenscontrol.robustness import farthest_node
from tests.random_structures import any_structure

# The start is so far from rest: of the size of the structure, and of what slackens a string or
# makes a slack one taut.
_AWAY, _STRETCH = 1e-3, 0.2

# What counts as inside the linear region: the nonlinear loop parts from the linear one by less.
CLOSE = 0.05


def known_structures():
    """Return structures that people know, by name: most have modes that no string reaches."""
    ball = tc.library.six_bar_ball(bar_length=1.0)
    flat = tc.library.snelson_x()
    angle = np.pi / 3 * np.arange(6)
    ring = np.array([np.cos(angle), np.sin(angle), 0 * angle])
    places = np.hstack([np.zeros((3, 1)), 0.5 * ring, ring])  # hub, ring, rim
    spokes = [(0, 1 + i) for i in range(6)] + [(1 + i, 7 + i) for i in range(6)]
    spokes += [(1 + i, 1 + (i + 1) % 6) for i in range(6)]
    return {
        "six-bar ball": ball,
        "six-bar ball on a face": replace(ball, fixed=[8, 4, 0]),
        "X frame in space": tc.Structure(
            np.vstack([flat.nodes, np.zeros(flat.nodes.shape[1])]), flat.bars, flat.strings, 1.0
        ),
        "prism(6)": tc.prism(6),
        "radial net": tc.Structure(
            places, [], spokes, [], fixed=list(range(7, 13)), point_mass=[0.1] * 7 + [0.0] * 6
        ),
    }


def known_plant(name):
    """Return the plant of one of them, rest lengths held."""
    structure = known_structures()[name]
    model = tc.Model(structure, strings=tc.LinearStrings(1000.0))
    return tc.linearize(model, tc.prestress(structure, force_density=20.0), input="rest_length")


def moved_reference(name, plant):
    """Return a reference on which a node moves by 8 to 10 cm relative to others, over a second."""
    N = plant.nodes
    stay = {"six-bar ball": [8, 4, 0], "X frame in space": [1, 3]}.get(name, [])
    node, by = (3, [0.0, 0.1, 0.0]) if "ball" in name else (0, [0.1, 0.0, 0.0])
    demands = [tc.NodesAt([node], N[:, [node]] + np.array(by)[:, None])]
    if name == "prism(6)":
        demands = [tc.Height(0.9, top=list(range(6)), bottom=list(range(6, 12)))]
    if stay:
        demands.append(tc.NodesAt(stay, N[:, stay]))
    model, bounds = plant.model, {"min_force_density": 5.0, "max_force_density": 80.0}
    goal = tc.shape_target(model, demands, **bounds)
    if name == "X frame in space":  # its bars cross: no path leads past that
        return goal.nodes, goal.nodes
    start = tc.prestress(model.structure, force_density=20.0)
    return tc.shape_path(model, start, goal, duration=1.0).reference(), goal.nodes


def disturbed(plant, share=0.05, seed=0):
    """Return a shape with nodes up to a share of the size away."""
    q = np.random.default_rng(seed).normal(size=plant.degrees_of_freedom)
    d = len(plant.nodes)
    moved = np.linalg.norm((plant.basis @ q).reshape(-1, d), axis=1).max()
    return plant.to_nodes(share * np.ptp(plant.nodes, axis=1).max() / moved * q)


def controlled_part(plant, run):
    """Return the size of q of what strings reach, over a run, m √kg."""
    found, r = reached_states(plant), plant.degrees_of_freedom
    inside = found.basis[:, : found.count]
    z = np.array([
        plant.measure(run.nodes[:, :, i], run.velocities[:, :, i]) for i in range(len(run.time))
    ])  # fmt: skip
    return np.linalg.norm((z / found.unit @ inside @ inside.T)[:, :r] * found.unit[:r], axis=1)


def random_structure(seed):
    """Return a structure of 2 to 12 bars, class 1 to 4, with many strings."""
    rng = np.random.default_rng(seed)
    if seed % 3 == 2:
        nodes, bars, strings = _turned_thrice(rng)
        fixed = [0, 1, 2] if rng.random() < 0.3 else []
    else:
        k = 1 + seed % 4
        drawn = any_structure(seed, k, 3 if rng.random() < 0.8 else 2, clusters=False)
        nodes, bars, fixed = drawn.nodes, [tuple(bar) for bar in drawn.bars], drawn.fixed.tolist()
        d, more = len(nodes), int(rng.integers(1, 7)) if k == 1 else 0
        for _ in range(more):  # single bars
            bars.append((nodes.shape[1], nodes.shape[1] + 1))
            nodes = np.hstack([nodes, 1.5 * rng.uniform(-1, 1, (d, 2))])
        n = nodes.shape[1]
        joined = {tuple(sorted(bar)) for bar in bars}
        strings = [
            (i, j)
            for i in range(n)
            for j in range(i + 1, n)
            if (i, j) not in joined and rng.random() < min(1.0, 6 / n) and not {i, j} <= {*fixed}
        ]
    masses = rng.uniform(0.5, 2.0, len(bars)) if seed % 3 < 2 else 1.0
    point = np.zeros(nodes.shape[1])
    point[np.setdiff1d(np.arange(len(point)), [*np.ravel(bars), *fixed])] = 0.5
    return tc.Structure(nodes, bars, strings, masses, fixed=fixed, point_mass=point)


def _turned_thrice(rng):
    """Return nodes, bars and strings that a turn by a third of a circle maps onto themselves."""
    count = int(rng.integers(1, 5))
    own = rng.uniform(-1, 1, (3, 2 * count))
    turn = Rotation.from_euler("z", 120, degrees=True)
    nodes = np.hstack([(turn**i).as_matrix() @ own for i in range(3)])
    m = 2 * count
    place = rng.permutation(m)
    bars = [
        (place[2 * j] + m * i, (place[2 * j + 1] + m * (i + 1)) % (3 * m))
        for j in range(count)
        for i in range(3)
    ]
    taken = {tuple(sorted(bar)) for bar in bars}
    strings = set()
    for a in range(m):
        for b in range(3 * m):
            if a != b and rng.random() < min(0.9, 4 / m):
                for i in range(3):
                    pair = tuple(sorted(((a + m * i) % (3 * m), (b + m * i) % (3 * m))))
                    strings |= {pair} - taken
    return nodes, bars, sorted(strings)


def stable_plant(seed):
    """Return the plant of a random structure at rest, rest lengths held; None if it is not stable.

    Stable: internal coordinates have no motion without stiffness, and bars do not collapse.
    """
    rng = np.random.default_rng(seed + 10**6)
    structure = random_structure(seed)
    if not (2 <= len(structure.bars) <= 12) or len(structure.strings) < 3:
        return None
    stiffness = 300.0 if seed % 3 == 2 else rng.uniform(100, 1000, len(structure.strings))
    damping = rng.choice([0.0, 0.0, 0.02]) * np.sqrt(stiffness)
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness, damping=damping))
    wound = structure.string_length() * (0.8 if seed % 3 == 2 else rng.uniform(0.6, 0.95))
    try:
        rest = tc.equilibrium(model, rest_length=wound)
        model = tc.Model(rest.structure, strings=model.strings)
        plant = tc.linearize(model, rest, input="rest_length", rest_length=wound)
    except ValueError:  # it collapses, or strings are neither taut nor slack
        return None
    r = plant.degrees_of_freedom
    if not r:
        return None
    squares = np.linalg.eigvalsh(-0.5 * (plant.A[r:, :r] + plant.A[r:, :r].T))
    return plant if squares[0] > 1e-4 * squares[-1] else None


def oracle(plant):
    """Return an orthonormal basis of what inputs reach: Arnoldi, vector by vector, 80 bits."""
    r = plant.degrees_of_freedom
    rate = np.longdouble(plant.spectral_radius)
    scale = np.r_[np.full(r, rate), np.ones(r, np.longdouble)]
    A = scale[:, None] * plant.A.astype(np.longdouble) / scale / rate
    B = plant.B.astype(np.longdouble)
    size = np.linalg.norm(plant.B, 2)
    force = np.max(plant.model.strings.stiffness) * np.linalg.norm(plant.basis, 2)
    # Strings along bars push nowhere, but for round-off beside their forces.
    waiting = list((B / size).T) if size > 1e-12 * force else []
    basis = np.zeros((2 * r, 0), np.longdouble)
    while waiting and basis.shape[1] < 2 * r:
        # The one that leads farthest out first.
        block = np.array(waiting).T
        for _ in range(2):
            block = block - basis @ (basis.T @ block)
        sizes = np.sqrt((block**2).sum(axis=0))
        best = int(sizes.argmax())
        if sizes[best] < 1e-11:
            break
        fresh = block[:, best] / sizes[best]
        basis = np.hstack([basis, fresh[:, None]])
        waiting = [column for i, column in enumerate(block.T) if i != best] + [A @ fresh]
    return basis.astype(float)


def pushed(plant, seed):
    """Return a start inside the linear region: z, of reached motions only."""
    rng = np.random.default_rng(seed)
    r, found = plant.degrees_of_freedom, reached_states(plant)
    inside = found.basis[:, : found.count]
    z = found.unit * (inside @ rng.normal(size=found.count))
    z[r:] = 0.0
    z = found.unit * (inside @ (inside.T @ (z / found.unit)))
    d, n = plant.nodes.shape
    moved = (plant.basis @ z[:r]).reshape(n, d).T
    structure = plant.model.structure
    along = structure.string_vectors(plant.nodes) / structure.string_length(plant.nodes)
    ends = structure.strings.T
    stretch = np.abs((along * (moved[:, ends[1]] - moved[:, ends[0]])).sum(axis=0))
    room = np.abs(structure.string_length(plant.nodes) - plant.rest_length)
    size = np.ptp(plant.nodes, axis=1).max()
    least = min(
        _AWAY * size / np.linalg.norm(moved, axis=0).max(),
        (_STRETCH * room / np.maximum(stretch, 1e-300)).min(),
    )
    return z * least


def judged(plant, seed):
    """Return what became of a design: an outcome, and figures."""
    found = tc.controllability(plant)
    told = oracle(plant)
    if told.shape[1] != len(plant.A) - found.unreachable:
        return f"oracle says {told.shape[1]} reached of {len(plant.A)}", {}
    states = reached_states(plant)
    mine = states.basis[:, : states.count]
    angle = np.linalg.norm(told - mine @ (mine.T @ told), 2) if told.size else 0.0
    if angle > 1e-4:
        return f"subspace off by {angle:.1e}", {}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rate = plant.spectral_radius
        sample = 0.3 / rate
        law = tc.LQR(plant, sample_time=sample)
    lasting = (law.left_alone.damping < 1e-9).any()
    if lasting != any("no string reaches" in str(each.message) for each in caught):
        return "silent", {}
    z, r = pushed(plant, seed), plant.degrees_of_freedom
    samples = 200
    run = tc.simulate(
        plant.model, samples * sample, plant.to_nodes(z[:r]), controller=law,
        step=sample / 2, output_step=sample,
    )  # fmt: skip
    transition, by_input, _ = plant.discretize(sample)
    loop = transition - by_input @ law.gain
    weight = np.linalg.norm
    start, linear = weight(z / states.unit), z
    apart = 0.0
    for k in range(samples + 1):
        now = plant.measure(run.nodes[:, :, k], run.velocities[:, :, k])
        apart = max(apart, float(weight((now - linear) / states.unit) / start))
        linear = loop @ linear
    figures = {
        "residual": law.riccati_residual, "angle": angle, "apart": apart,
        "left alone": len(law.left_alone), "decay": float(weight(linear / states.unit) / start),
    }  # fmt: skip
    return ("holds" if apart < CLOSE else "leaves the linear region"), figures


def known_table():
    """Print what controllers make of known structures, disturbed by 5 % of the size."""
    print("structure, shares of the disturbance left after 1 s: LQR, MPC, NMPC; left alone, Hz")
    for name in known_structures():
        plant = known_plant(name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            laws = (
                tc.LQR(plant, sample_time=0.02),
                tc.MPC(plant, horizon=10, sample_time=0.02),
                tc.NMPC(plant, horizon=5, sample_time=0.02),
            )
        left = []
        for law in laws:
            run = tc.simulate(
                plant.model, 1.0, disturbed(plant), controller=law, step=1e-3, output_step=0.02
            )
            sizes = controlled_part(plant, run)
            left.append(f"{sizes[-1] / sizes[0]:.1e}")
        print(f"{name}: {', '.join(left)}; {laws[0].left_alone.frequency.round(3)}")


def moved_table():
    """Print how far nodes are from a goal to which one of them moves, a second after its path."""
    print("structure: a node moves by, mm; farthest node off at the end, MPC, NMPC")
    for name in known_structures():
        plant = known_plant(name)
        reference, goal = moved_reference(name, plant)
        settings = {"sample_time": 0.02, "reference": reference}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            laws = tc.MPC(plant, horizon=10, **settings), tc.NMPC(plant, horizon=5, **settings)
        off = []
        for law in laws:
            run = tc.simulate(
                plant.model, 2.0, plant.nodes, controller=law, step=1e-3, output_step=0.02
            )
            off.append(f"{1e3 * farthest_node(plant, run.nodes[:, :, -1:], goal):.4f}")
        by = 1e3 * np.linalg.norm(goal - plant.nodes, axis=0).max()
        print(f"{name}: {by:.0f}; {', '.join(off)}; {dict(run.control.status_count)}")


def campaign(count, start=0):
    """Return outcome, figures and structure by seed, for so many stable structures."""
    done, seed = {}, start
    while len(done) < count:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of slack strings and of bars that cross
            plant = stable_plant(seed)
        if plant is not None:
            try:
                done[seed] = (*judged(plant, seed), plant.model.structure)
            except ValueError as error:
                done[seed] = (f"refused: {error}", {}, plant.model.structure)
        seed += 1
    return done


def main():
    """Run a campaign."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    given = parser.parse_args()
    known_table()
    moved_table()
    done = campaign(given.count, given.start)
    for seed, (outcome, figures, structure) in done.items():
        if outcome != "holds":
            print(seed, structure, outcome, figures)
    structures = [structure for _, _, structure in done.values()]
    print("outcomes:", dict(Counter(outcome.split(":")[0] for outcome, _, _ in done.values())))
    print("bars:", dict(sorted(Counter(len(each.bars) for each in structures).items())))
    print("class:", dict(sorted(Counter(each.structure_class for each in structures).items())))
    print("supported:", sum(len(each.fixed_rows) > 0 for each in structures))
    for name in ("residual", "angle", "apart", "decay"):
        values = [figures[name] for _, figures, _ in done.values() if figures]
        print(f"largest {name}: {max(values):.1e}, median {np.median(values):.1e}")
    alone = Counter(figures["left alone"] for _, figures, _ in done.values() if figures)
    print("modes left alone:", dict(sorted(alone.items())))


if __name__ == "__main__":
    main()
