"""Linearization: against complex steps of the oracle, against nonlinear motion, and refusals."""

import numpy as np
import pytest
from scipy.linalg import expm

import tenscontrol as tc
from tests.dynamics.scenes import paper_force_density, random_turn
from tests.oracle import HeldForceDensity, RigidBars, consistent_mass, state_jacobians
from tests.plant.scenes import INPUTS, KINDS, law_of, prism_plant, weighted_rest

every_input = pytest.mark.parametrize("held", INPUTS)
every_kind = pytest.mark.parametrize("kind", KINDS)


def reduced(A, P, T):
    """Take the four blocks of a node-level matrix to coordinates q."""
    blocks = [np.hsplit(rows, 2) for rows in np.vsplit(A, 2)]
    return np.block([[P @ block @ T for block in row] for row in blocks])


def expected_plant(plant, law, held):
    """A and B from complex steps of the saddle-point oracle, in the plant's own basis."""
    structure = plant.model.structure
    still = np.zeros_like(plant.nodes)
    A, B = state_jacobians(structure, plant.nodes, still, law, held)
    T = plant.basis
    M = np.kron(consistent_mass(structure), np.eye(3))
    # q by least squares in the metric of the kinetic energy: no use of TᵀMT = I.
    P = np.linalg.solve(T.T @ M @ T, T.T @ M)
    return reduced(A, P, T), np.vstack([P @ part for part in np.split(B, 2)])


def relative(found, expected):
    return np.abs(found - expected).max() / np.abs(expected).max()


# ---- derivatives ----


@pytest.mark.parametrize("damping", [0.0, 0.7])
@every_kind
@every_input
def test_derivatives_are_those_of_the_oracle(rest, held, kind, damping):
    plant = prism_plant(rest, held, kind, damping)
    A, B = expected_plant(plant, law_of(held, damping=damping), plant.equilibrium_input)
    assert relative(plant.A, A) < 1e-12
    assert relative(plant.B, B) < 1e-12


@every_kind
@every_input
def test_derivatives_with_string_nodes_are_those_of_the_oracle(held, kind):
    plant = prism_plant(weighted_rest(), held, kind, damping=0.4, stiffness=300.0)
    law = law_of(held, stiffness=300.0, damping=0.4)
    A, B = expected_plant(plant, law, plant.equilibrium_input)
    assert relative(plant.A, A) < 1e-12
    assert relative(plant.B, B) < 1e-12


@every_input
def test_constant_rigidity_is_stiffness_over_rest_length(prism, rest, held):
    """At its operating point a string of rigidity EA has the stiffness EA/l0."""
    model = tc.Model(prism, strings=tc.ElasticStrings(70.0))
    plant = tc.linearize(model, rest, input=held)
    stiffness = 70.0 / plant.rest_length
    # Winding also changes the stiffness: dT/dl0 = -EA l/l0², a factor l/l0 more than -k.
    linear = prism_plant(rest, held, stiffness=stiffness)
    np.testing.assert_allclose(plant.A, linear.A, rtol=0, atol=1e-10)
    ratio = prism.string_length() / plant.rest_length if held == "rest_length" else 1.0
    np.testing.assert_allclose(plant.B, linear.B * ratio, rtol=0, atol=1e-9)


@every_kind
@every_input
def test_the_coordinates_are_invariant_under_the_plant(rest, held, kind):
    assert prism_plant(rest, held, kind, damping=0.3).invariance_residual < 1e-12


@every_input
@pytest.mark.parametrize("kind", ["minimal", "internal"])
def test_undamped_stiffness_is_symmetric(rest, held, kind):
    """In mass-orthonormal coordinates the stiffness is the Hessian of an energy."""
    plant = prism_plant(rest, held, kind)
    r = plant.degrees_of_freedom
    stiffness, friction = -plant.A[r:, :r], plant.A[r:, r:]
    assert np.abs(stiffness - stiffness.T).max() < 1e-11
    assert np.abs(friction).max() == 0.0


@pytest.mark.parametrize("kind", ["minimal", "internal"])
def test_damping_takes_energy_out(rest, kind):
    plant = prism_plant(rest, "rest_length", kind, damping=0.5)
    r = plant.degrees_of_freedom
    friction = -plant.A[r:, r:]
    assert np.abs(friction - friction.T).max() < 1e-12
    assert np.linalg.eigvalsh(0.5 * (friction + friction.T)).min() > -1e-12


@every_kind
def test_holding_force_density_and_holding_rest_length_are_different_plants(rest, kind):
    by_force, by_length = (prism_plant(rest, held, kind) for held in INPUTS)
    assert np.abs(by_force.A - by_length.A).max() > 10.0
    # One input is the other times -k/l: the same directions are pushed.
    ratio = -100.0 / rest.structure.string_length()
    np.testing.assert_allclose(by_length.B, by_force.B * ratio, rtol=0, atol=1e-11)


@every_input
def test_a_turned_and_moved_structure_has_the_same_poles(prism, rest, held):
    moved = tc.Structure(
        random_turn(1) @ prism.nodes + [[3.0], [-2.0], [5.0]],
        prism.bars,
        prism.strings,
        bar_mass=1.0,
        string_groups=prism.string_groups,
    )
    there = prism_plant(tc.prestress(moved, rest.force_density), held)
    here = prism_plant(rest, held)
    squares = [np.sort(np.linalg.eigvals(p.A @ p.A).real) for p in (here, there)]
    np.testing.assert_allclose(squares[1], squares[0], rtol=0, atol=1e-8)


# ---- against the nonlinear motion ----


@pytest.mark.parametrize("damping", [0.0, 0.5])
@every_input
def test_the_error_of_the_linear_model_is_quadratic_in_the_disturbance(rest, held, damping):
    """Fitted order 2 over a factor 8 in size, disturbed in shape, velocity and input."""
    plant = prism_plant(rest, held, damping=damping)
    r = plant.degrees_of_freedom
    random = np.random.default_rng(4)
    z, v = random.normal(size=2 * r), random.normal(size=9)
    z[r:] *= 10.0
    v *= 20.0 if held == "force_density" else 0.2
    duration = 0.2
    exponent = np.block([[plant.A, (plant.B @ v)[:, None]], [np.zeros((1, 2 * r + 1))]])
    linear = (expm(duration * exponent) @ np.r_[z, 1.0])[:-1]
    sizes = 0.01 / 2.0 ** np.arange(4)
    errors = []
    for size in sizes:
        run = tc.simulate(
            plant.model,
            duration,
            plant.to_nodes(size * z[:r]),
            plant.to_velocities(size * z[:r], size * z[r:]),
            **{held: plant.equilibrium_input + size * v},
            tolerance=1e-12,
            output_step=duration,
        )
        moved = plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])
        errors.append(np.linalg.norm(moved - size * linear))
    order = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert 1.95 < order < 2.05
    assert errors[-1] < 0.01 * np.linalg.norm(sizes[-1] * linear)


# ---- away from equilibrium ----


def unbalanced_point(prism):
    return tc.OperatingPoint(prism.nodes, paper_force_density(9.0))


def test_a_shape_out_of_balance_is_refused_with_the_force_that_is_left(prism):
    gamma = paper_force_density(9.0)
    model = tc.Model(prism)
    bodies = RigidBars(prism, HeldForceDensity(gamma))
    acceleration = bodies.node_acceleration(prism.nodes, np.zeros((3, 6)))
    left = np.linalg.norm(acceleration @ consistent_mass(prism), axis=0).max()
    with pytest.raises(ValueError, match=f"unbalanced force of {left:.3g} N"):
        tc.linearize(model, unbalanced_point(prism))


@every_kind
@every_input
def test_away_from_equilibrium_the_drift_is_the_acceleration(prism, held, kind):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    plant = tc.linearize(model, unbalanced_point(prism), held, kind, require_equilibrium=False)
    gamma = paper_force_density(9.0)
    bodies = RigidBars(prism, HeldForceDensity(gamma))
    acceleration = bodies.node_acceleration(prism.nodes, np.zeros((3, 6))).T.ravel()
    r = plant.degrees_of_freedom
    T = plant.basis
    M = np.kron(consistent_mass(prism), np.eye(3))
    expected = np.linalg.solve(T.T @ M @ T, T.T @ M @ acceleration)
    assert np.linalg.norm(expected) > 1.0
    np.testing.assert_allclose(plant.drift, np.r_[np.zeros(r), expected], rtol=0, atol=1e-12)


@every_kind
@every_input
def test_at_equilibrium_there_is_no_drift(rest, held, kind):
    assert np.abs(prism_plant(rest, held, kind).drift).max() < 1e-12


@every_kind
@every_input
def test_derivatives_away_from_equilibrium_are_those_of_the_oracle(prism, held, kind):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, 0.2))
    plant = tc.linearize(model, unbalanced_point(prism), held, kind, require_equilibrium=False)
    A, B = expected_plant(plant, law_of(held, damping=0.2), plant.equilibrium_input)
    assert relative(plant.A, A) < 1e-12
    assert relative(plant.B, B) < 1e-12


def test_a_load_holds_a_shape_that_does_not_balance_alone(prism):
    gamma = paper_force_density(9.0)
    bars = np.full(3, 12.0)
    load = (tc.statics.equilibrium_matrix(prism) @ np.r_[gamma, bars]).reshape(3, 6, order="F")
    rest = tc.prestress(prism, gamma, external_force=load)
    plant = tc.linearize(tc.Model(prism, external_force=True), rest, coordinates="minimal")
    assert plant.invariance_residual < 1e-12
    assert np.abs(plant.drift).max() < 1e-12
    A, B = expected_plant_under_load(plant, gamma, load)
    assert relative(plant.A, A) < 1e-8
    assert relative(plant.B, B) < 1e-12


def expected_plant_under_load(plant, gamma, load):
    """Central differences of the bodies: a load keeps its direction when the structure turns."""
    structure = plant.model.structure
    bodies = RigidBars(structure, HeldForceDensity(gamma), load)
    r, step = plant.degrees_of_freedom, 1e-6

    def forward(z):
        N, V = plant.to_nodes(z[:r]), plant.to_velocities(z[:r], z[r:])
        acceleration = bodies.node_acceleration(N, V).T.ravel()
        M = np.kron(consistent_mass(structure), np.eye(3))
        return plant.basis.T @ M @ acceleration

    units = step * np.eye(2 * r)
    slopes = np.column_stack([(forward(u) - forward(-u)) / (2 * step) for u in units])
    A = np.vstack([np.hstack([np.zeros((r, r)), np.eye(r)]), slopes])
    _, B = expected_plant(plant, HeldForceDensity, gamma)
    return A, B


# ---- kinks ----


def slack_point(prism):
    gamma = paper_force_density(30.0)
    gamma[4] = 0.0
    return tc.OperatingPoint(prism.nodes, gamma)


def test_rest_length_of_a_slack_string_is_refused_by_its_number(prism):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    with pytest.raises(ValueError, match="string 4 has γ = 0 N/m, at the border"):
        tc.linearize(model, slack_point(prism), "rest_length", require_equilibrium=False)


def test_force_density_of_a_slack_string_is_an_input_like_others(prism):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    plant = tc.linearize(model, slack_point(prism), require_equilibrium=False)
    assert np.linalg.norm(plant.B[:, 4]) > 0.1


# ---- immutability ----


@pytest.mark.parametrize("name", ["A", "B", "drift", "force_density", "rest_length", "basis"])
def test_a_plant_is_read_only(rest, name):
    with pytest.raises(ValueError, match="read-only"):
        getattr(prism_plant(rest, "rest_length"), name)[...] = 0.0


def test_internal_coordinates_are_refused_where_a_load_couples_turning_and_shape(prism):
    gamma = np.repeat([17.3205, 17.3205, 9.0], 3)
    load = tc.statics.equilibrium_matrix(prism) @ np.r_[gamma, 12.0, 12.0, 12.0]
    rest = tc.prestress(prism, gamma, external_force=load.reshape(3, 6, order="F"))
    model = tc.Model(prism, external_force=True)
    with pytest.raises(ValueError, match=r"coordinates='internal' leave out motions .*'minimal'"):
        tc.linearize(model, rest)
    assert tc.linearize(model, rest, coordinates="minimal").invariance_residual < 1e-12
