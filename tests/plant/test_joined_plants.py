"""Linear plants where bars share nodes: against differences of the full dynamics, and an oracle."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.plant.joined import SCENES, arm, at_rest, d_bar, oracle, spine

every_scene = pytest.mark.parametrize("structure", SCENES.values(), ids=SCENES)
LAW = tc.LinearStrings(stiffness=200.0, damping=0.3)


def acceleration(plant, load):
    """q̈ of reduced states, by the oracle, from force densities by the law."""
    structure, r = plant.model.structure, plant.degrees_of_freedom
    project = plant.coordinates.project(np.eye(plant.nodes.size))[:, structure.free_rows]

    def of(z, u):
        N, V = plant.to_nodes(z[:r]), plant.to_velocities(z[:r], z[r:])
        gamma = u
        if plant.input == "rest_length":
            length = structure.string_length(N)
            S, Sd = structure.string_vectors(N), structure.string_vectors(V)
            each = (S * Sd).sum(axis=0) / np.linalg.norm(S, axis=0)
            rate = np.bincount(structure.segment_string, each, minlength=len(u))
            gamma = np.maximum(0, 200.0 * (length - u) + 0.3 * rate) * (length > u) / length
        return project @ oracle(structure, N, V, gamma, load)

    return of


@every_scene
@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_linear_plant_is_the_slope_of_the_full_dynamics(structure, held):
    model, at = at_rest(structure, strings=LAW)
    plant = tc.linearize(model, at, input=held, coordinates="minimal")
    assert plant.invariance_residual < 1e-13
    of, r = acceleration(plant, at.external_force), plant.degrees_of_freedom
    random, u = np.random.default_rng(5), plant.equilibrium_input
    assert np.abs(of(np.zeros(2 * r), u)).max() < 1e-10
    step = 1e-5
    for _ in range(3):
        dz, du = random.normal(size=2 * r), random.normal(size=len(u)) * 0.1
        ahead, behind = (of(sign * dz, u + sign * du) for sign in (step, -step))
        expected = (plant.A @ dz + plant.B @ du)[r:]
        scale = np.abs(plant.A[r:]).max()
        np.testing.assert_allclose(
            (ahead - behind) / (2 * step) / scale, expected / scale, atol=2e-7
        )


@pytest.mark.parametrize(
    ("name", "held"),
    [
        *((name, "rest_length") for name in SCENES if name != "random_3d_2"),
        ("arm", "force_density"),
    ],
)
def test_reduced_dynamics_and_their_slopes_are_exact(name, held):
    structure = SCENES[name]
    model, at = at_rest(structure, strings=tc.LinearStrings(200.0, damping=0.3))
    plant = tc.linearize(model, at, input=held, coordinates="minimal")
    of, r = acceleration(plant, at.external_force), plant.degrees_of_freedom
    random, u = np.random.default_rng(6), plant.equilibrium_input
    z = 0.01 * random.uniform(-1, 1, 2 * r)
    found = tc.plant.reduced_dynamics.reduced_acceleration(plant, taut=False)(z, u)
    scale = np.abs(plant.A[r:]).max()
    expected = of(z, u)
    np.testing.assert_allclose(np.array(found).ravel() / scale, expected / scale, atol=1e-12)
    value, by_q, by_v, by_u = (
        np.array(part)
        for part in tc.plant.reduced_dynamics.acceleration_slopes(plant, taut=False)(z, u)
    )
    np.testing.assert_allclose(value.ravel() / scale, expected / scale, atol=1e-12)
    dz, du, step = random.normal(size=2 * r), 0.1 * random.normal(size=len(u)), 1e-5
    ahead, behind = (of(z + sign * dz, u + sign * du) for sign in (step, -step))
    slope = by_q @ dz[:r] + by_v @ dz[r:] + by_u @ du
    np.testing.assert_allclose((ahead - behind) / (2 * step) / scale, slope / scale, atol=1e-6)


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_frequencies_in_the_plane_are_those_of_the_same_structure_in_space(held):
    found = []
    for dimension in (2, 3):
        structure = d_bar(dimension)
        model = tc.Model(structure, strings=LAW)
        at = tc.OperatingPoint(structure.nodes, [5.0, 5.0])
        found.append(tc.modes(tc.linearize(model, at, input=held)))
    assert found[0].shape.shape == (2, 4, 1)
    np.testing.assert_allclose(found[1].pole, found[0].pole, rtol=1e-12)
    assert found[0].label == found[1].label


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
def test_frequencies_in_the_plane_are_among_those_in_space(held):
    """Out of the plane the arm swings as well; both do not meet."""
    flat = arm()
    nodes = np.vstack([flat.nodes, np.zeros(5)])
    deep = tc.Structure(nodes, flat.bars, flat.paths, flat.bar_mass, fixed=[0, 4, (3, "y")])
    model, at = at_rest(flat, strings=LAW)
    load = np.vstack([at.external_force, np.zeros(5)])
    there = tc.Model(deep, external_force=load, strings=LAW)
    above = tc.OperatingPoint(nodes, at.force_density, load)
    plane, space = (
        tc.modes(tc.linearize(*each, input=held, coordinates="minimal"))
        for each in ((model, at), (there, above))
    )
    assert len(plane.pole) == 2 < len(space.pole)
    inside = [np.abs(shape[2]).max() < 1e-9 for shape in np.moveaxis(space.shape, 2, 0)]
    np.testing.assert_allclose(space.pole[inside], plane.pole, rtol=1e-10)


def test_frequency_of_a_rhombus_in_closed_form():
    """A rhombus of angle a, with bars of one length, sheared as a whole: no spring if γ is held."""
    a, m, length = 0.7, 1.0, 1.0
    x, y = length * np.cos(a), length * np.sin(a)
    nodes = np.array([[-x, 0.0, x, 0.0], [0.0, -y, 0.0, y]])
    structure = tc.Structure(nodes, [[0, 1], [1, 2], [2, 3], [3, 0]], [[0, 2], [1, 3]], m)
    k, gamma = 50.0, 5.0
    model = tc.Model(structure, strings=tc.LinearStrings(k))
    plant = tc.linearize(model, tc.OperatingPoint(nodes, [gamma, gamma]), input="rest_length")
    # Strings s = 2 l cos a and 2 l sin a change by −2y and 2x per rad; each stores (k − γ) of it
    # beside what bars' forces give: together with γ they cost nothing.
    stiffness = (k - gamma) * ((2 * y) ** 2 + (2 * x) ** 2)
    # Each bar turns about its centre at ½ l and all centres move at ½ l.
    inertia = 4 * m * length**2 * (1 / 12 + 1 / 4)
    found = tc.modes(plant)
    assert found.frequency[0] == pytest.approx(
        np.sqrt(stiffness / inertia) / (2 * np.pi), rel=1e-12
    )
    assert found.label == ("affine",)
    held = tc.linearize(model, tc.OperatingPoint(nodes, [gamma, gamma]))
    assert tc.modes(held).frequency[0] == 0.0


def test_modes_of_node_coordinates_have_a_zero_for_each_length():
    model, at = at_rest(arm())
    found = tc.modes(tc.linearize(model, at, coordinates="nodes"))
    assert found.label.count("constraint") == 3
    assert len(found.label) == 5
    for kind, shape in zip(found.label, np.moveaxis(found.shape, 2, 0), strict=True):
        B, db = arm().bar_vectors(arm().nodes), arm().bar_vectors(shape)
        assert (np.abs((B * db).sum(axis=0)).max() > 0.1) == (kind == "constraint")


def test_a_bounce_in_a_fixed_rim_is_not_affine():
    net = tc.net(4, 4, 0.5, 0.1)
    model = tc.Model(net, strings=tc.LinearStrings(1e3), gravity=9.81)
    rest = tc.equilibrium(model, rest_length=0.9 * net.string_length())
    for held in ("force_density", "rest_length"):
        labels = tc.modes(tc.linearize(model, rest, input=held)).label
        assert set(labels) <= {"elastic", "mechanism"}
    flat = tc.prestress(net, force_density=10.0)
    assert "affine" not in tc.modes(tc.linearize(tc.Model(net), flat)).label


def test_strings_that_a_cluster_runs_through_are_one_input():
    model, at = at_rest(arm(), strings=LAW)
    plant = tc.linearize(model, at, input="rest_length", coordinates="minimal")
    assert plant.B.shape == (4, 3)
    assert plant.state_names[:2] == ["q[0]", "q[1]"]
    nodes = tc.linearize(model, at, coordinates="nodes")
    assert nodes.state_names[:5] == ["x[1]", "y[1]", "x[2]", "y[2]", "x[3]"]
    assert nodes.output_names[:3] == ["delta_x[0]", "delta_y[0]", "delta_x[1]"]
    found = tc.plant.string_outputs.string_map(plant, "rest_length")
    np.testing.assert_allclose(found.force_density, at.force_density, rtol=1e-12)
    length = arm().string_length()
    np.testing.assert_allclose(found.tension, at.force_density * length, rtol=1e-12)
    # T = k (L − L0): a longer rest length gives −k.
    np.testing.assert_allclose(found.tension_by_input.toarray(), -200.0 * np.eye(3), atol=1e-9)


def slack_arm():
    """The arm with its last string slack by 0.1 m."""
    structure = arm()
    gamma = np.array([4.0, 3.0, 0.0])
    from tests.plant.joined import internal_forces

    load = -internal_forces(structure, structure.nodes, gamma, np.array([1.0, 2.0, 3.0]))
    model = tc.Model(structure, external_force=load, strings=tc.LinearStrings(200.0))
    rest = tc.to_rest_length(model, structure.nodes, gamma).rest_length
    rest = rest + np.array([0.0, 0.0, 0.1])
    return model, tc.OperatingPoint(structure.nodes, gamma, load), rest


def test_a_slack_string_moves_nothing_and_stops_nothing():
    model, at, rest = slack_arm()
    options = {"input": "rest_length", "coordinates": "minimal"}
    plant = tc.linearize(model, at, **options, rest_length=rest)
    assert plant.slack.tolist() == [2]
    assert not plant.B[:, 2].any()
    assert plant.rest_length[2] == rest[2]
    of, r = acceleration(plant, at.external_force), plant.degrees_of_freedom
    u, step, du = plant.equilibrium_input, 1e-6, np.array([0.1, -0.2, 0.3])
    damped = LAW.damping
    assert damped == 0.3
    still = np.zeros(2 * r)
    slope = (of(still, u + step * du) - of(still, u - step * du)) / (2 * step)
    np.testing.assert_allclose(slope, (plant.B @ du)[r:], rtol=1e-6)
    assert tc.plant.in_coordinates(plant, "nodes").slack.tolist() == [2]
    law = tc.LQR(plant)
    assert not law.gain[2].any()
    mpc = tc.MPC(plant, sample_time=0.02, horizon=5)
    command = mpc.command(0.0, plant.to_nodes(np.full(r, 0.01)), np.zeros_like(plant.nodes))
    assert str(command) == "ok"
    assert command.value[2] == pytest.approx(rest[2], rel=1e-6)
    with pytest.raises(ValueError, match="string 2, which is slack"):
        tc.MPC(plant, sample_time=0.02, horizon=5, min_force_density=1.0)


def test_only_at_the_kink_a_slack_string_is_refused():
    model, at, rest = slack_arm()
    options = {"input": "rest_length", "coordinates": "minimal"}
    with pytest.raises(ValueError, match="at the border between taut and slack"):
        tc.linearize(model, at, **options)
    wrong = rest * np.array([1.1, 1.0, 1.0])
    with pytest.raises(ValueError, match=r"rest_length\[0\] is .* expected"):
        tc.linearize(model, at, **options, rest_length=wrong)
    bare = tc.Model(model.structure, external_force=at.external_force)
    with pytest.raises(ValueError, match="no string law"):
        tc.linearize(bare, at, rest_length=rest)


def test_a_dead_centre_is_refused():
    """Two bars in line between fixed nodes hold their middle, but not in a shape next to it."""
    nodes = np.array([[0.0, 1.0, 2.0, 1.0], [0.0, 0.5, 0.0, 2.0]])
    structure = tc.Structure(nodes, [[0, 1], [1, 3]], [[1, 2]], 1.0, fixed=[0, 2, (3, "y")])
    flat = structure.nodes.copy()
    flat[:, 1] = np.hypot(1.0, 0.5) * np.array([0.0, 1.0])
    flat[:, 3] = [0.0, 2.0]
    with pytest.raises(ValueError, match="in nodes"):
        tc.dynamics.coordinates(tc.Model(structure), nodes=flat)


def test_the_spine_of_redundant_vertebrae_has_six_coordinates_each():
    model, at = at_rest(spine())
    plant = tc.linearize(model, at)
    assert plant.degrees_of_freedom == 12
    assert tc.controllability(plant).is_controllable
