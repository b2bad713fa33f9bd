"""Accelerations, λ, energies and momenta of structures of any class, against the dense oracle."""

from functools import lru_cache

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import machine_code
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.dynamics.machine_code import compiler
from tests.known_structures import KNOWN, class2_tower, d_bar, spine
from tests.oracle import consistent_mass, node_acceleration, string_forces, string_motion
from tests.random_structures import any_motion_of, any_structure as new_structure

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")
# More by ``python -m tests.benchmarks.oracle_agreement``.
SEEDS = range(60)
CLOSE = 1e-11  # relative


@pytest.fixture(autouse=True, scope="module")
def own_cache(tmp_path_factory):
    """Libraries are made anew, quickly, and not left behind."""
    quick = tuple("-O0" if flag.startswith("-O") else flag for flag in machine_code.FLAGS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine_code, "FLAGS", quick)
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


any_structure = lru_cache(new_structure)


def off(found, expected):
    """How far two results are apart, as a part of the larger one's size."""
    return np.abs(found - expected).max(initial=0) / max(np.abs(expected).max(initial=0), 1e-12)


def acted_on(structure, seed):
    """A motion, force densities and a load."""
    random = np.random.default_rng(seed)
    gamma = random.uniform(0, 10, len(structure.strings))
    return *any_motion_of(structure, seed), gamma, random.normal(size=structure.nodes.shape)


def assert_moves_as_the_oracle(structure, seed):
    N, V, gamma, W = acted_on(structure, seed)
    acceleration, lam = node_acceleration(structure, N, V, gamma, W)
    model = tc.Model(structure, external_force=True)
    at = [part[:, structure.free] for part in (N, V)]
    at += [gamma, W[:, structure.free]]
    assert off(np.array(model.acceleration(*at)), acceleration[:, structure.free]) < CLOSE
    assert off(np.array(model.bar_force_density(*at)).ravel(), lam) < CLOSE
    return acceleration


def assert_form_moves_as_the_oracle(structure, seed, form, law_of=tc.LinearStrings):
    """All three functions of the equation, with damped strings of which some are slack."""
    N, V, _, W = acted_on(structure, seed)
    random = np.random.default_rng(seed)
    count = len(structure.strings)
    k, c, u = (random.uniform(*ends, count) for ends in ((20, 100), (0, 1), (0.3, 1.5)))
    taut = random.integers(0, 2, count).astype(float)
    model = tc.Model(structure, law_of(k, c), external_force=W)
    equation = model.equation("rest_length", form=form)
    length, rate = string_motion(structure, N, V)
    stretch = length - u if law_of is tc.LinearStrings else length / u - 1
    gamma = taut * (k * stretch + c * rate) / length
    acceleration, _ = node_acceleration(structure, N, V, gamma, W)
    rows = structure.free_rows
    velocity, force = (each.T.ravel()[rows] for each in (V, W + string_forces(structure, N, gamma)))
    x = pack_state(structure, N, V)
    slope = Evaluator(equation.slope)(x, u, taut)[0]
    assert off(slope, np.concatenate([velocity, acceleration.T.ravel()[rows]])) < CLOSE
    q, v = np.split(x, 2)
    assert off(Evaluator(equation.force)(q, v, u, taut)[0], force) < CLOSE
    gap, gap_rate = Evaluator(equation.gap)(x, u)
    assert off(gap_rate, rate) < CLOSE
    stiffness = k if law_of is tc.LinearStrings else k / u
    assert off(gap, np.minimum(length - u, length - u + c * rate / stiffness)) < CLOSE


@pytest.mark.parametrize("first", SEEDS[::20])
def test_random_structures_accelerate_as_the_oracle(first):
    for seed in range(first, first + 20):
        assert_moves_as_the_oracle(any_structure(seed), seed)


@pytest.mark.parametrize("name", KNOWN)
def test_known_structures_accelerate_as_the_oracle(name):
    assert_moves_as_the_oracle(KNOWN[name](), 1)


@pytest.mark.parametrize("seed", range(8))
def test_mass_and_stiffness_matrices_give_the_motion(seed):
    """N̈ M + N K = W in all coordinates that supports leave free."""
    structure = any_structure(seed)
    N, V, gamma, W = acted_on(structure, seed)
    model = tc.Model(structure, external_force=True)
    at = [part[:, structure.free] for part in (N, V)] + [gamma, W[:, structure.free]]
    acceleration = np.zeros_like(N)
    acceleration[:, structure.free] = np.array(model.acceleration(*at))
    residual = acceleration @ model.mass_matrix() + N @ model.stiffness_matrix(*at).full() - W
    assert np.abs(residual.T.ravel()[structure.free_rows]).max() < 1e-10


def test_the_random_structures_are_of_all_kinds():
    some = [any_structure(seed) for seed in SEEDS]
    assert {each.structure_class for each in some} == set(range(1, 7))
    assert {each.dimension for each in some} == {2, 3}
    for kind in (
        [each.rollers for each in some],
        [each.has_clusters for each in some],
        [block.is_redundant for each in some for block in each.blocks],
        [each.point_mass[each.bar_nodes].any() for each in some],
        [len(each.fixed) for each in some],
    ):
        assert sum(map(bool, kind)) > 5


@pytest.mark.parametrize("law", [tc.LinearStrings, tc.ElasticStrings])
@pytest.mark.parametrize("first", range(0, 20, 10))
def test_operations_on_all_members_give_the_same(first, law):
    for seed in range(first, first + 10):
        assert_form_moves_as_the_oracle(any_structure(seed), seed, "mapped", law)


@pytest.mark.parametrize("form", ["flat", "mapped", pytest.param("loops", marks=needs_compiler)])
@pytest.mark.parametrize("name", KNOWN)
def test_all_forms_of_known_structures_give_the_same(name, form):
    assert_form_moves_as_the_oracle(KNOWN[name](), 2, form)


@needs_compiler
@pytest.mark.parametrize("seed", range(4))
def test_loops_of_random_structures_give_the_same(seed):
    assert_form_moves_as_the_oracle(any_structure(seed, seed + 1), seed, "loops")


CORNERS = {
    "no strings": tc.Structure([[0, 1, 2], [0, -1, -1]], [(0, 1), (1, 2)], [], 1.0, fixed=[0]),
    "no bars, rollers": tc.Structure(
        [[0, 1, 2], [0, 0, 0], [0, 0, 0]], [], [(0, 1), (1, 2)], [], point_mass=[0, 1, 1],
        fixed=[0, (1, "y"), (1, "z"), (2, "x")],
    ),
    "bars that cannot move": tc.Structure(
        [[0, 1, 2, 3], [0, 1, 0, 1]], [(0, 1), (1, 2)], [(1, 3)], 1.0,
        point_mass=[0, 0, 0, 1], fixed=[0, 2],
    ),
    "one bar with a payload": tc.Structure([[0, 1], [0, 1]], [(0, 1)], [], 1.0, point_mass=[0, 2]),
    "one clustered string": tc.Structure(
        [[0, 1, 2], [0, 1, 0]], [], [(0, 1, 2)], [], point_mass=[0, 1, 0], fixed=[0, 2]
    ),
}  # fmt: skip


@pytest.mark.parametrize("form", ["mapped", pytest.param("loops", marks=needs_compiler)])
@pytest.mark.parametrize("name", [name for name in CORNERS if len(CORNERS[name].strings)])
def test_structures_that_lack_a_part_give_the_same_in_all_forms(name, form):
    assert_form_moves_as_the_oracle(CORNERS[name], 0, form)


@pytest.mark.parametrize("form", ["mapped", pytest.param("loops", marks=needs_compiler)])
@pytest.mark.parametrize(
    "name", ["spine", "arm", "clustered D-bar", "no strings", "one bar with a payload"]
)
def test_held_force_densities_give_the_same_in_all_forms(name, form):
    structure = CORNERS[name] if name in CORNERS else KNOWN[name]()
    N, V, gamma, _ = acted_on(structure, 3)
    x = pack_state(structure, N, V)
    model = tc.Model(structure, gravity=9.81)
    flat, other = (
        Evaluator(model.equation("force_density", form=each).slope)(x, gamma, np.zeros(0))[0]
        for each in ("flat", form)
    )
    assert off(other, flat) < CLOSE


def test_operations_on_all_members_have_derivatives():
    structure = KNOWN["arm"]()
    model = tc.Model(structure, tc.LinearStrings(50.0, 0.5))
    x = pack_state(structure, *any_motion_of(structure, 0))
    u, taut = np.full(4, 0.5), np.ones(4)
    flat, mapped = (
        np.array(model.equation("rest_length", form=form).slope.jacobian()(x, u, taut, 0)[0])
        for form in ("flat", "mapped")
    )
    assert off(mapped, flat) < CLOSE


# ---- energies and momenta ----


@pytest.mark.parametrize("seed", range(12))
def test_energies_and_momenta_are_those_of_the_masses(seed):
    structure = any_structure(seed)
    N, V = any_motion_of(structure, seed)
    x = pack_state(structure, N, V)
    model = tc.Model(structure, tc.LinearStrings(30.0))
    momenta = V @ consistent_mass(structure)
    assert float(model.kinetic_energy(x)) == pytest.approx(0.5 * (momenta * V).sum())
    linear, angular = (np.array(part).ravel() for part in model.momentum(x))
    np.testing.assert_allclose(linear, momenta.sum(axis=1), atol=1e-13)
    turning = N[0] * momenta[1] - N[1] * momenta[0]
    assert angular[-1] == pytest.approx(turning.sum(), abs=1e-12)
    assert len(angular) == (3 if structure.dimension == 3 else 1)
    length, _ = string_motion(structure, N, V)
    gamma, rest = np.linspace(1, 9, len(length)), 0.8 * np.ones(len(length))
    assert float(model.potential_energy(x, gamma)) == pytest.approx(0.5 * gamma @ length**2)
    stretch = np.maximum(length - rest, 0)
    assert float(model.elastic_energy(x, rest)) == pytest.approx(15.0 * stretch @ stretch)


@pytest.mark.parametrize("seed", range(3))
def test_forces_are_the_slopes_of_the_stored_energy(seed):
    """Virtual work of clustered strings too: power of the forces is the loss of ½ Σ γ L²."""
    structure = any_structure(seed, clusters=True)
    N, V = any_motion_of(structure, seed)
    x = pack_state(structure, N, V)
    gamma = np.linspace(1, 9, len(structure.strings))
    force = tc.Model(structure).equation("force_density").force
    q, v = np.split(x, 2)
    power = float(v @ np.array(force(q, v, gamma, np.zeros(0))).ravel())
    length, rate = string_motion(structure, N, V)
    assert power == pytest.approx(-gamma @ (length * rate), rel=1e-12)


def test_two_bars_on_one_fixed_node_have_the_momentum_of_both():
    nodes = [[0, 1, 0, -1], [0, 0, 1, 0], [0, 0, 0, 1]]
    structure = tc.Structure(nodes, [(0, 1), (0, 2)], [(1, 3), (2, 3)], 3.0, fixed=[0, 3])
    x = pack_state(structure, structure.nodes, np.array([[0, 0, 0, 0], [0, 2, 0, 0], [0, 0, 4, 0]]))
    linear, _ = tc.Model(structure).momentum(x)
    np.testing.assert_allclose(np.array(linear).ravel(), [0, 3, 6])


def test_gravity_in_the_plane_is_along_y():
    structure = d_bar()
    model = tc.Model(structure, gravity=9.81)
    fall = np.array(model.acceleration(structure.nodes, np.zeros((2, 4)), [0, 0]))
    np.testing.assert_allclose(fall, np.outer([0, -9.81], np.ones(4)), atol=1e-13)
    assert model.constant_force[1].sum() == pytest.approx(-9.81 * structure.bar_mass.sum())


# ---- what it costs ----


def test_instructions_grow_linearly_with_the_blocks():
    counts = [tc.Model(spine(k)).dynamics.n_instructions() for k in (2, 3, 4, 6, 10)]
    growth = np.diff(counts) / [1, 1, 2, 4]
    np.testing.assert_allclose(growth, growth[-1], rtol=0.02)
    chains = [tc.Model(class2_tower(k)).dynamics.n_instructions() for k in (5, 6, 7, 15, 31)]
    growth = np.diff(chains) / [1, 1, 8, 16]
    np.testing.assert_allclose(growth, growth[-1], rtol=0.02)


def test_the_graph_of_blocks_does_not_grow():
    counts = [
        tc.Model(spine(k)).equation("force_density", form="mapped").slope.n_instructions()
        for k in (3, 4, 8)
    ]
    assert np.ptp(counts) == 0
