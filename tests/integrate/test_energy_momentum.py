"""The method for stiff strings: order, what it conserves, stability, and what it costs."""

from itertools import combinations

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import evaluate_columns
from tenscontrol.integrate import DOP853, EnergyMomentum, IntegrationError
from tenscontrol.integrate.energy_momentum import step_equations
from tests.dynamics.scenes import (
    paper_force_density,
    random_motion,
    random_structure,
    rest_lengths,
    side_by_side,
)
from tests.integrate.stepping import smooth_equation
from tests.integrate.test_rk4 import fitted_order, oscillator
from tests.located_motion import exact_motion
from tests.oracle import HeldForceDensity, HeldRestLength

STEPS = np.array([4e-3, 2e-3, 1e-3, 5e-4])


def energy(model, states, lengths):
    """Kinetic energy, that stored in strings, and that of constant loads."""
    free = model.structure.free
    load = model.constant_force[:, free].ravel(order="F")
    held = np.repeat(lengths[:, None], states.shape[1], axis=1)
    moving, stored = (
        evaluate_columns(function, *arguments)[0].ravel()
        for function, *arguments in (
            (model.kinetic_energy, states), (model.elastic_energy, states, held)
        )
    )  # fmt: skip
    return moving + stored - load @ states[: len(load)]


def bar_error(structure, states):
    """Largest deviation of a bar length in any of the states, relative."""
    return max(
        np.abs(
            np.linalg.norm(structure.bar_vectors(nodes), axis=0) / structure.bar_length - 1
        ).max()
        for nodes in all_nodes(structure, states)
    )


def all_nodes(structure, states):
    for x in np.atleast_2d(states.T):
        nodes = structure.nodes.copy()
        nodes[:, structure.free] = x[: len(x) // 2].reshape(-1, 3).T
        yield nodes


def hung_bars(law=None):
    """A free bar and one that swings about a fixed end, a bead between them, and gravity."""
    structure = tc.Structure(
        nodes=np.array(
            [[0, 0, 0.0], [1, 0, 0.2], [1.3, 0.1, 0.1], [2, 0.5, -0.3], [0.2, 1, 0.3], [1, 1, 0.5]]
        ).T,
        bars=[[1, 0], [2, 3]],
        strings=[[1, 2], [3, 4], [2, 5], [1, 5], [5, 4], [3, 1]],
        bar_mass=[1.0, 0.7],
        string_node_mass=0.3,
        fixed=[0, 4],
    )
    law = tc.LinearStrings(stiffness=80.0) if law is None else law
    return tc.Model(structure, strings=law, gravity=9.81)


def stiff_prism(stiffness=1e8, node_mass=1e-5, segments=4, rotation=1.0, twist=0.1):
    """The prism at rest with stiff, light strings, set to turn and to twist slowly.

    The twist is the motion of the prism in which no string stretches, to first order.
    """
    prism = tc.prism()
    rest = tc.prestress(prism, force_density=30 / np.sqrt(3))
    massive = tc.subdivide(prism, segments=segments, node_mass=node_mass)
    law = tc.LinearStrings(stiffness * tc.structure.segment_counts(massive))
    gamma = tc.structure.spread_force_density(massive, rest.force_density)
    lengths = law.rest_length(massive.string_length(), gamma)
    members = np.vstack([prism.strings, prism.bars])
    rows = np.zeros((len(members), 3, 6))
    for row, (a, b) in zip(rows, members, strict=True):
        row[:, b] = prism.nodes[:, b] - prism.nodes[:, a]
        row[:, a] = -row[:, b]
    centred = prism.nodes - prism.nodes.mean(axis=1, keepdims=True)
    turns = [np.cross(axis, centred.T).T for axis in np.eye(3)]
    shifts = [np.outer(axis, np.ones(6)) for axis in np.eye(3)]
    rigid = np.array([*turns, *shifts]).reshape(6, -1)
    mode = np.linalg.svd(np.vstack([rows.reshape(len(members), -1), rigid]))[2][-1].reshape(3, 6)
    mode *= np.sign(mode[0, 0]) * twist / np.linalg.norm(mode, axis=0).max()
    velocity = mode + rotation * np.cross([0.2, 0.3, 1.0], centred.T).T
    # Beads lie on the line between the ends of their string, and move with it.
    velocities = np.zeros_like(massive.nodes)
    velocities[:, :6] = velocity
    for string, (a, b) in enumerate(prism.strings):
        beads = massive.strings[massive.string_parent == string]
        for bead in np.setdiff1d(beads.ravel(), [a, b]):
            along = massive.nodes[:, bead] - massive.nodes[:, a]
            part = np.linalg.norm(along) / prism.string_length()[string]
            velocities[:, bead] = (1 - part) * velocity[:, a] + part * velocity[:, b]
    model = tc.Model(massive, strings=law)
    return model, pack_state(massive, massive.nodes, velocities), np.asarray(lengths)


# ---- accuracy ----


@pytest.mark.parametrize(("vertical", "damping"), [(45.0, 1.0), (9.0, 0.0)])
def test_order_is_two_through_slack_and_taut(prism, vertical, damping):
    """Fitted after 1 s against the oracle. With 9 N/m strings switch, with 45 N/m none does."""
    lengths = rest_lengths(prism, paper_force_density(vertical), 100.0)
    law = HeldRestLength(lengths, 100.0, damping)
    exact, switches = exact_motion(prism, law, np.array([0.0, 1.0]))
    assert (len(switches) > 5) == (vertical == 9.0 and damping == 0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping))
    start = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    errors = []
    for step in STEPS:
        span = EnergyMomentum(model.equation("rest_length"), step).advance(start, lengths, 1.0, 1)
        (nodes,) = all_nodes(prism, span.states)
        errors.append(np.abs(nodes - exact[:, :, -1]).max())
    assert 1.8 <= fitted_order(STEPS, errors) <= 2.3
    assert errors[-1] < 5e-5


def test_order_is_two_where_force_densities_are_held(prism):
    gamma = paper_force_density(45.0)
    exact, _ = exact_motion(prism, HeldForceDensity(gamma), np.array([0.0, 1.0]))
    model = tc.Model(prism)
    start = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    errors = []
    for step in STEPS:
        span = EnergyMomentum(model.equation("force_density"), step).advance(start, gamma, 1.0, 1)
        (nodes,) = all_nodes(prism, span.states)
        errors.append(np.abs(nodes - exact[:, :, -1]).max())
    assert 1.9 <= fitted_order(STEPS, errors) <= 2.1
    before, after = (
        float(model.kinetic_energy(x)) + float(model.potential_energy(x, gamma))
        for x in (start, span.states[:, -1])
    )
    assert abs(after - before) < 1e-11 * before


@pytest.mark.parametrize("damping", [0.0, 0.5])
@pytest.mark.parametrize("kind", ["linear", "elastic"])
def test_order_is_two_with_supports_weights_and_both_string_laws(kind, damping):
    """Against DOP853 at 1e-12 while no string goes slack."""
    law = {
        "linear": tc.LinearStrings(80.0, damping),
        "elastic": tc.ElasticStrings(10.0, damping),
    }[kind]
    model = hung_bars(law)
    structure = model.structure
    lengths = 0.3 * structure.string_length()
    equation = model.equation("rest_length")
    start = pack_state(structure, structure.nodes, np.zeros_like(structure.nodes))
    exact = DOP853(equation, 1e-12).advance(start, lengths, 0.05, 1).states[:, 0]
    assert (structure.string_length(next(all_nodes(structure, exact[:, None]))) > lengths).all()
    errors = []
    for step in STEPS:
        span = EnergyMomentum(equation, step).advance(start, lengths, 0.05, 1)
        errors.append(np.abs(span.states[:, 0] - exact).max())
    assert 1.9 <= fitted_order(STEPS, errors) <= 2.1
    assert bar_error(structure, span.states) < 1e-14


def test_error_follows_the_tolerance(prism, paper_motion):
    lengths = paper_motion.rest_length
    assert paper_motion.time[400] == 0.4
    exact = paper_motion.nodes[:, :, 400]
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    start = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    works, errors = [], []
    for tolerance in (1e-5, 1e-7, 1e-9):
        method = EnergyMomentum(model.equation("rest_length"), tolerance=tolerance)
        span = method.advance(start, lengths, 0.4, 3)
        (nodes,) = all_nodes(prism, span.states[:, -1:])
        errors.append(np.abs(nodes - exact).max())
        works.append(span.work)
    # Of order 2: the error of a step is as h³, that of the whole as h², steps as 1/h.
    assert errors[0] < 3e-3
    for i in (0, 1):
        assert 5 < errors[i] / errors[i + 1] < 80
        assert 3 < works[i + 1].steps / works[i].steps < 7
    assert all(work.rejections < work.steps / 2 for work in works)


# ---- what stays what it is ----


def test_many_steps_keep_energy_and_bars_through_slack_and_taut():
    """A bar thrown about between strings that are slack most of the time, under gravity."""
    structure = tc.Structure(
        nodes=np.array([[0, 0, 0.0], [0.6, 0, 0], [-0.5, 0.2, 0.5], [1.2, -0.1, 0.6]]).T,
        bars=[[0, 1]],
        strings=[[0, 2], [1, 3], [1, 2]],
        bar_mass=[1.0],
        fixed=[2, 3],
    )
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness=3e3), gravity=9.81)
    lengths = np.array([0.9, 0.9, 1.2])
    start = pack_state(structure, structure.nodes, np.zeros_like(structure.nodes))
    method = EnergyMomentum(model.equation("rest_length"), step=2e-3)
    span = method.advance(start, lengths, duration=40.0, outputs=800)
    assert span.work.steps == 20_000
    taut = np.array(
        [structure.string_length(n) > lengths for n in all_nodes(structure, span.states)]
    )
    assert (np.abs(np.diff(taut, axis=0)).sum(axis=0) > 20).all()
    energies = energy(model, span.states, lengths)
    first = energy(model, start[:, None], lengths)[0]
    scale = np.ptp(evaluate_columns(model.kinetic_energy, span.states)[0])
    assert np.abs(energies - first).max() < 1e-9 * scale
    assert bar_error(structure, span.states) < 1e-13


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_momenta_stay_what_they_are(seed):
    """A structure of bars and point masses in random motion, its strings slack or taut."""
    structure = random_structure(seed)
    model = tc.Model(structure, strings=tc.LinearStrings(200.0, damping=seed - 1.0))
    start = pack_state(structure, *random_motion(structure, seed))
    lengths = structure.string_length()
    span = EnergyMomentum(model.equation("rest_length"), step=2e-3).advance(start, lengths, 1.0, 5)
    before = np.ravel(model.momentum(start))
    for x in span.states.T:
        for now, then in zip(model.momentum(x), model.momentum(start), strict=True):
            np.testing.assert_allclose(now, then, rtol=0, atol=2e-11 * np.abs(before).max())
    assert bar_error(structure, span.states) < 1e-13


def test_damping_only_takes_energy(prism):
    lengths = rest_lengths(prism, paper_force_density(9.0), 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0, damping=0.05))
    velocities = np.cross([3.0, 1.0, 2.0], prism.nodes.T).T
    start = pack_state(prism, prism.nodes, velocities)
    for step in (1e-3, 3e-2):
        method = EnergyMomentum(model.equation("rest_length"), step)
        span = method.advance(start, lengths, 100 * step, 100)
        energies = energy(model, np.column_stack([start, span.states]), lengths)
        assert np.diff(energies).max() < 1e-11 * energies[0]
        assert energies[-1] < energies[0]


def test_bars_keep_their_lengths_for_any_solution_of_newtons_iteration():
    """However wrong the mean velocities are: lengths are kept by construction."""
    model = hung_bars()
    structure = model.structure
    step = step_equations(model.equation("rest_length"))
    random = np.random.default_rng(5)
    x = pack_state(structure, structure.nodes, np.zeros_like(structure.nodes))
    for size in (1e-3, 1.0, 1e3):
        y = size * random.normal(size=step.guess.size1_out(0))
        end = np.array(step.end(y, x, 0.01))
        assert bar_error(structure, end) < 1e-15 * max(1, np.abs(end).max())
        bars, rates = (
            structure.bar_vectors(part)
            for part in (next(all_nodes(structure, end)), _velocities(structure, end[:, 0]))
        )
        assert np.abs((bars * rates).sum(axis=0)).max() < 1e-13 * size


def _velocities(structure, x):
    velocities = np.zeros_like(structure.nodes)
    velocities[:, structure.free] = x[len(x) // 2 :].reshape(-1, 3).T
    return velocities


# ---- stiff strings ----


@pytest.mark.parametrize("exponent", [-2, 2, 5])
def test_stable_whatever_the_step_times_the_frequency(exponent):
    """A turning prism with beads of 1 g on its strings; h ω from 1e-2 to 1e5."""
    step = 2e-3
    frequency = 10.0**exponent / step
    stiffness = frequency**2 * 1e-3 / 4 / 2  # ω² = 4 · 2 k / m
    prestress = tc.prestress(tc.prism(), force_density=min(17.3205, 0.1 * stiffness))
    massive = tc.subdivide(prestress.structure, segments=2, node_mass=1e-3)
    model = tc.Model(massive, strings=tc.LinearStrings(2 * stiffness))
    gamma = tc.structure.spread_force_density(massive, prestress.force_density)
    lengths = model.strings.rest_length(massive.string_length(), gamma)
    velocities = np.cross([0.2, 0.3, 1.0], massive.nodes.T).T
    start = pack_state(massive, massive.nodes, velocities)
    method = EnergyMomentum(model.equation("rest_length"), step)
    span = method.advance(start, lengths, 1.0, 50)
    assert span.work.steps == 500
    energies = energy(model, span.states, lengths)
    first = energy(model, start[:, None], lengths)[0]
    assert np.abs(energies - first).max() < 1e-9 * first
    assert bar_error(massive, span.states) < 1e-13
    speeds = np.abs(span.states[len(start) // 2 :])
    assert speeds.max() < 20 * np.abs(velocities).max()


def test_slow_motion_of_very_stiff_strings_costs_little():
    """k = 1e8 N/m, beads of 10 mg: error below 1e-4 m per 5 s in a hundredth of the evaluations.

    An explicit method is stable up to h = 2/ω at best; ω is that of the segments. The error is
    measured against steps of a fifth of the length, whose own error is a twenty-fifth.
    """
    model, start, lengths = stiff_prism()
    equation = model.equation("rest_length")
    duration = 0.25
    span = EnergyMomentum(equation, step=5e-4).advance(start, lengths, duration, 25)
    fine = EnergyMomentum(equation, step=1e-4).advance(start, lengths, duration, 25)
    positions = slice(0, len(start) // 2)
    error = np.abs(span.states - fine.states)[positions].max()
    assert error < 1e-4 * duration / 5.0
    moved = np.abs(fine.states - start[:, None])[positions].max()
    assert moved > 0.1
    frequency = np.sqrt(4 * 4e8 / 1e-5)
    explicit = duration * frequency / 2
    assert span.work.evaluations < 0.01 * explicit
    assert span.work.rejections == 0
    energies = energy(model, span.states, lengths)
    assert np.abs(energies - energies[0]).max() < 1e-9 * energies[0]


def test_agrees_with_an_explicit_method_where_that_can_go():
    """Stiff, but not too stiff for DOP853 at 1e-10: k = 1e5 N/m, beads of 10 g."""
    model, start, lengths = stiff_prism(stiffness=1e5, node_mass=1e-2, segments=2)
    equation = model.equation("rest_length")
    explicit = DOP853(equation, 1e-10).advance(start, lengths, 0.2, 1)
    moved = np.abs(explicit.states[:18, 0] - start[:18]).max()
    assert moved > 0.05
    for step, bound in ((2e-3, 5e-6), (1e-3, 2.5e-6), (5e-4, 1e-6)):
        span = EnergyMomentum(equation, step).advance(start, lengths, 0.2, 1)
        assert np.abs(span.states - explicit.states)[:18].max() < bound


@pytest.mark.parametrize("copies", [2, 4])
def test_work_of_a_step_grows_with_the_members(copies):
    """Instructions, and entries of the sparse factors."""

    def cost(count):
        structure = tc.subdivide(side_by_side(tc.prism(), count), segments=2, node_mass=0.01)
        model = tc.Model(structure, strings=tc.LinearStrings(100.0))
        system = step_equations(model.equation("rest_length")).system
        V, R, *_ = system.sparsity_out(1).qr_sparse()
        return np.array([system.n_instructions(), V.nnz(), R.nnz()])

    np.testing.assert_allclose(cost(copies), copies * cost(1), rtol=0.02)


# ---- steps, failures, arguments ----


def test_a_step_that_newton_does_not_solve_is_halved():
    """A fast turn in steps of more than half a turn."""
    model, start, lengths = stiff_prism(segments=1, rotation=20.0, twist=1.0)
    equation = model.equation("rest_length")
    span = EnergyMomentum(equation, step=0.2).advance(start, lengths, 1.0, 5)
    assert span.work.rejections > 0
    assert span.work.steps > 5
    energies = energy(model, np.column_stack([start, span.states]), lengths)
    assert np.abs(energies - energies[0]).max() < 1e-9 * energies[0]


@pytest.mark.parametrize("setting", ["step", "tolerance"])
@pytest.mark.parametrize("flatness", [1e-2, 1e-4])
def test_flat_bodies_of_redundant_bars_converge(setting, flatness):
    """Ten bars between five points, nearly in a plane: J nearly loses rank, multipliers are large.

    The length of bars must not be held by the difference of two squares: its round-off,
    magnified by one over the flatness, stopped the iteration.
    """
    random = np.random.default_rng(2)
    nodes = random.uniform(-1.0, 1.0, (3, 7)) * np.array([[1.0], [1.0], [flatness]])
    structure = tc.Structure(
        nodes,
        bars=list(combinations(range(5), 2)),
        strings=[[5, i] for i in range(5)] + [[6, 0], [6, 2], [6, 5]],
        bar_mass=10.0 ** random.uniform(-2.0, 2.0, 10),
        string_node_mass=1.0,
    )
    model = tc.Model(structure)
    start = pack_state(structure, nodes, np.zeros((3, 7)))
    held = random.uniform(1.0, 5.0, 8)
    options = {"step": {"step": 1e-3}, "tolerance": {"tolerance": 1e-7}}[setting]
    equation = model.equation("force_density", form="mapped")
    span = EnergyMomentum(equation, **options).advance(start, held, 0.4, 4)
    exact = DOP853(equation, 1e-10).advance(start, held, 0.4, 4)
    moved = np.abs(exact.states - start[:, None])[:21].max()
    assert moved > 0.3
    assert np.abs(span.states - exact.states)[:21].max() < 1e-4
    # Two iterations and the one that sees that nothing is left, where most steps take fewer.
    assert span.work.evaluations < 2 * 3.5 * (span.work.steps * (1 if setting == "step" else 3))


def test_a_motion_that_runs_away_stops_with_what_was_good():
    """A point mass between strings that push, which no string does: γ < 0 held."""
    structure = tc.Structure(
        nodes=np.array([[-1, 0, 0.0], [1, 0, 0], [0.01, 0, 0]]).T,
        bars=[],
        strings=[[0, 2], [2, 1]],
        bar_mass=[],
        string_node_mass=0.01,
        fixed=[0, 1],
    )
    equation = tc.Model(structure).equation("force_density")
    start = pack_state(structure, structure.nodes, np.zeros((3, 3)))
    method = EnergyMomentum(equation, step=1e-2)
    with pytest.raises(IntegrationError, match="energy_momentum failed at") as info:
        method.advance(start, np.full(2, -100.0), 10.0, 1000)
    states = info.value.span.states
    assert states.shape[1] == int(info.value.time / 1e-2 + 1e-9)
    assert 100 < states.shape[1] < 1000
    assert np.isfinite(states).all()
    assert info.value.span.work.rejections > 10


@pytest.mark.parametrize("options", [{"step": 1e-3}, {"tolerance": 1e-6}])
def test_nonsense_is_never_a_result(prism, options):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    start = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    method = EnergyMomentum(model.equation("rest_length"), **options)
    with pytest.raises(ValueError, match=r"held\[0\] is nan"):
        method.advance(start, np.full(9, np.nan), 1.0, 10)
    with pytest.raises(IntegrationError) as info:
        method.advance(start, np.full(9, -1e70), 1.0, 10)
    assert info.value.time == 0
    assert info.value.span.states.shape == (36, 0)
    assert info.value.span.work.steps == 0


def test_work_is_counted(prism):
    """Two evaluations an iteration, of forces and of their Jacobian."""
    lengths = rest_lengths(prism, paper_force_density(45.0), 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    start = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    times = []
    span = EnergyMomentum(model.equation("rest_length"), 1e-3).advance(
        start, lengths, 0.1, 4, times.append
    )
    assert span.work.steps == 100
    assert span.work.rejections == span.work.switches == span.work.missed == 0
    assert 2 * 2 * 100 <= span.work.evaluations <= 2 * 3 * 100
    assert (np.diff(times) > 0).all()
    assert np.abs(np.subtract.outer([0.025, 0.05, 0.075, 0.1], times)).min(axis=1).max() < 1e-15


def test_steps_are_chained_without_a_seam(prism):
    outputs = 7
    lengths = rest_lengths(prism, paper_force_density(45.0), 100.0)
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    method = EnergyMomentum(model.equation("rest_length"), step=0.2 / 1400)
    state = pack_state(prism, prism.nodes, np.zeros((3, 6)))
    whole = method.advance(state, lengths, 0.2, outputs)
    assert whole.work.steps == 1400
    for i in range(outputs):
        state = method.advance(state, lengths, 0.2 / outputs, 1).states[:, -1]
        np.testing.assert_allclose(whole.states[:, i], state, rtol=0, atol=1e-10)


def test_the_loop_over_steps_can_be_written_as_c(prism, tmp_path):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    method = EnergyMomentum(model.equation("rest_length"), step=1e-3)
    generator = ca.CodeGenerator("steps.c")
    generator.add(method._build()[8])
    generator.generate(f"{tmp_path}/")
    assert "casadi_qr" in (tmp_path / "steps.c").read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "found neither"),
        ({"step": 1e-3, "tolerance": 1e-6}, "found both"),
        ({"step": -1.0}, "step is -1.0, expected a positive"),
        ({"tolerance": 0.0}, "tolerance is 0.0, expected a positive"),
        ({"tolerance": 1e-17}, "double precision goes no further"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(prism, options, message):
    with pytest.raises(ValueError, match=message):
        EnergyMomentum(tc.Model(prism).equation("force_density"), **options)


def test_an_equation_of_no_structure_is_refused():
    with pytest.raises(ValueError, match="not of a structure"):
        EnergyMomentum(smooth_equation(oscillator()), step=1e-3)
