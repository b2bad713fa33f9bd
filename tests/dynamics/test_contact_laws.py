"""Contact laws: forces against formulas, energies, gaps, all forms of a model, bad input."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics import HertzGround, SmoothGround
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.machine_code import compiler
from tests.dynamics.scenes import Cubic
from tests.oracle import Plane, node_acceleration

X, Y = ca.SX.sym("x"), ca.SX.sym("y")
HILLS = ca.Function("hills", [X, Y], [0.2 * ca.sin(2 * X) * ca.cos(3 * Y)])
RUBBING = {"damping": 0.3, "friction": 0.5, "slip_speed": 0.02}


LAWS = {
    "linear": (tc.Ground, 5e3),
    "hertz": (HertzGround, 1e5),
    "smooth": (SmoothGround, 1e4),
    "own": (Cubic, 1e6),
}
each_law = pytest.mark.parametrize("name", LAWS)


def law_of(name, **options):
    kind, stiffness = LAWS[name]
    return kind(stiffness, **options)


def values(function, *arguments):
    """Numbers of a function of rows."""
    symbols = [ca.SX.sym("a", *np.shape(a)) for a in arguments]
    found = ca.Function("f", symbols, [function(*symbols)])(*arguments)
    return np.array(found)


def nodes(seed, count=200, depth=0.05):
    """Random positions about the surface z = 0, and velocities, shape (3, count)."""
    rng = np.random.default_rng(seed)
    N = rng.normal(size=(3, count))
    N[2] *= depth
    return N, 4 * rng.normal(size=(3, count))


@pytest.mark.parametrize(("name", "exponent"), [("linear", 1.0), ("hertz", 1.5), ("own", 3.0)])
def test_forces_are_those_of_the_formulas(name, exponent):
    normal = np.array([0.6, 0.0, 0.8])
    law = law_of(name, normal=normal, height=0.1, **RUBBING)
    plane = Plane(law.stiffness, 0.3, 0.5, 0.02, tuple(normal), 0.1, exponent)
    N, V = nodes(0)
    presses = plane.border(N.T, V.T) > 0
    assert 20 < presses.sum() < 180
    forces = values(law.force, N, V)
    np.testing.assert_allclose(forces.T, plane.force(N.T, V.T, presses), rtol=1e-12, atol=1e-12)


@each_law
def test_the_stored_energy_is_the_work_of_slow_sinking(name):
    law = law_of(name, damping=0.0)
    depths = np.linspace(0.002, 0.08, 40)[None, :]
    small = 1e-6
    rise = values(law.stored_energy, depths + small) - values(law.stored_energy, depths - small)
    force = values(lambda p: law.normal_force(p, 0 * p), depths)
    np.testing.assert_allclose(rise / (2 * small), force, rtol=1e-6)
    closed = {
        "linear": 5e3 / 2 * depths**2, "hertz": 1e5 * 0.4 * depths**2.5, "own": 1e6 / 4 * depths**4
    }  # fmt: skip
    if name in closed:
        np.testing.assert_allclose(values(law.stored_energy, depths), closed[name], rtol=1e-13)
    assert not values(law.stored_energy, -np.ones((1, 3))).any()


@pytest.mark.parametrize("height", [0.0, HILLS])
@each_law
def test_mean_forces_do_the_work_that_is_stored(name, height):
    law = law_of(name, height=height)
    before, _ = nodes(1)
    after = before + 0.1 * np.random.default_rng(2).normal(size=before.shape)
    mean = values(lambda a, b: law.mean_force(a, b, 0.01), before, after)
    stored = [
        values(lambda N: law.stored_energy(law.sinking(N, 0 * N)[0]), N) for N in (before, after)
    ]
    work = (mean * (after - before)).sum(axis=0)
    np.testing.assert_allclose(work, (stored[0] - stored[1])[0], rtol=1e-9, atol=1e-9)


@each_law
def test_damping_and_friction_only_take_energy(name):
    law, elastic = law_of(name, **RUBBING), law_of(name, damping=1e-12)
    before, _ = nodes(3)
    after = before + 0.1 * np.random.default_rng(4).normal(size=before.shape)
    work = [
        (values(lambda a, b, law=each: law.mean_force(a, b, 0.01), before, after)
         * (after - before)).sum(axis=0)
        for each in (law, elastic)
    ]  # fmt: skip
    # The rounded factor of the smooth law is a little above that without damping.
    assert (work[0] <= work[1] * (1 + np.sign(work[1]) * 0.01 * (name == "smooth")) + 1e-9).all()


@pytest.mark.parametrize("damping", [0.0, 0.3, 3.0])
def test_the_gap_is_positive_where_there_is_a_force(damping):
    law = tc.Ground(5e3, damping)
    rng = np.random.default_rng(5)
    depth, rate = rng.normal(size=(1, 1000)), 5 * rng.normal(size=(1, 1000))
    gap = values(law.gap, depth, rate)
    np.testing.assert_array_equal(gap > 0, (depth > 0) & (1 + damping * rate > 0))
    sinking = rate > 0
    np.testing.assert_allclose(gap[sinking], depth[sinking], rtol=1e-15)


def tower():
    """A class-2 tower that nothing holds."""
    return tc.library.class2_tower(floating=True)


def grounds():
    """A curved floor for some nodes, a wall of another law, and a smooth one."""
    return [
        tc.Ground(5e3, height=HILLS, **RUBBING, nodes=[0, 1, 2, 5]),
        HertzGround(1e4, normal=[-1.0, 0.0, 0.2], height=-0.1, **RUBBING),
        SmoothGround(1e4, normal=[0.0, 1.0, 0.0], height=0.0, **RUBBING, width=0.05),
    ]


@pytest.mark.parametrize(
    "make",
    [tc.prism, tc.library.six_bar_ball, tower, lambda: tc.subdivide(tc.prism(), 2, node_mass=0.1)],
)
def test_all_forms_of_a_model_agree(make):
    structure = make()
    model = tc.Model(structure, strings=tc.LinearStrings(100.0), gravity=9.81, ground=grounds())
    rng = np.random.default_rng(6)
    N = structure.nodes - [[0.0], [0.0], [0.3]]
    x, lengths = pack_state(structure, N, rng.normal(size=N.shape)), structure.string_length()
    flat = model.equation("rest_length", form="flat")
    gap, rate = (np.array(each) for each in flat.gap(x, lengths))
    pressing = (gap > 0).astype(float)
    contacts = model.contacts.switches
    assert 2 < pressing[-contacts:].sum() < contacts
    found = np.array(flat.slope(x, lengths, pressing))
    for form in ("mapped", *(["loops"] if compiler() else [])):
        other = model.equation("rest_length", form=form)
        for one, two in zip((gap, rate), other.gap(x, lengths), strict=True):
            np.testing.assert_allclose(np.array(two), one, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(
            np.array(other.slope(x, lengths, pressing)), found, rtol=1e-10, atol=1e-9
        )
    whole = np.array(model.rest_length_dynamics(x, lengths))
    np.testing.assert_allclose(whole, found, rtol=1e-10, atol=1e-9)


def test_accelerations_on_the_ground_are_the_oracles():
    """Dense multipliers, with forces of planes in NumPy."""
    structure = tower()
    law = tc.Ground(5e3, normal=[0.6, 0.0, 0.8], **RUBBING)
    model = tc.Model(structure, ground=law)
    rng = np.random.default_rng(7)
    N, gamma = structure.nodes, rng.uniform(1, 5, len(structure.strings))
    V = np.cross([0.3, 0.5, 1.0], N.T).T + np.array([[1.0], [2.0], [-3.0]])
    plane = Plane(5e3, 0.3, 0.5, 0.02, (0.6, 0.0, 0.8))
    ground = plane.force(N.T, V.T, plane.border(N.T, V.T) > 0).T
    assert np.count_nonzero(ground[2]) in range(1, N.shape[1])
    expected, _ = node_acceleration(structure, N, V, gamma, ground)
    np.testing.assert_allclose(
        np.array(model.acceleration(N, V, gamma)), expected, rtol=0, atol=1e-10
    )


def test_what_is_fixed_or_not_named_touches_nothing():
    structure = tc.Structure(tc.prism().nodes, tc.prism().bars, tc.prism().strings, 1.0, fixed=[3])
    model = tc.Model(structure, ground=[tc.Ground(1e3), tc.Ground(1e3, nodes=[3, 4])])
    assert [each.tolist() for each in model.contacts.nodes] == [[0, 1, 2, 4, 5], [4]]
    assert model.contacts.switches == 6
    assert len(model.ground) == 2
    assert tc.Model(structure).contacts is None
    assert tc.Model(structure).ground == ()


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"stiffness": 0.0}, "stiffness"),
        ({"stiffness": float("nan")}, "stiffness"),
        ({"damping": -0.1}, "damping is -0.1, expected at least 0"),
        ({"friction": -1.0}, "friction is -1, expected at least 0"),
        ({"slip_speed": 0.0}, "slip_speed"),
        ({"normal": [0.0, 0.0, 0.0]}, "normal"),
        ({"height": float("inf")}, "height"),
        ({"height": ca.Function("f", [X], [ca.vertcat(X, X)])}, "with one number as its value"),
        ({"height": HILLS, "normal": [1.0, 0.0, 0.0]}, "which is measured"),
        ({"nodes": [-1]}, "nodes"),
    ],
)
def test_what_is_no_ground_is_refused(given, text):
    with pytest.raises(ValueError, match=text):
        tc.Ground(**({"stiffness": 1e3} | given))


@pytest.mark.parametrize(
    ("ground", "text"),
    [
        (tc.Ground(1e3, normal=[0.0, 1.0]), r"ground.normal has 2 entries, expected 3"),
        ([tc.Ground(1e3), tc.Ground(1e3, nodes=[6])], r"ground\[1\].nodes"),
        (tc.Ground(1e3, height=ca.Function("f", [X], [X])), r"ground.height is a function of 1"),
    ],
)
def test_ground_that_does_not_fit_the_structure_is_refused(prism, ground, text):
    with pytest.raises((ValueError, IndexError), match=text):
        tc.Model(prism, ground=ground)


def test_what_is_no_contact_law_is_refused(prism):
    with pytest.raises(TypeError, match="ground"):
        tc.Model(prism, ground=5e3)
