"""Limits of NMPC on strings and outputs, and unknown loads: on the nonlinear prediction itself."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import NMPC, OutputLimit
from tenscontrol.control.mpc.real_time_iteration import limited_rows
from tenscontrol.demo import tour as demo
from tests.control.mpc.nmpc_oracle import optimality
from tests.control.mpc.test_constraints import height_row, pushed

SAMPLE = 0.02
STILL = np.zeros((3, 6))
EXACT = {"tolerance": 1e-7, "max_iterations": 50000, "iterations": 20}


@pytest.fixture(scope="module", params=["force_density", "rest_length"])
def plant(request):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(200.0))
    return tc.linearize(model, tc.prestress(prism, 30 / np.sqrt(3)), input=request.param)


def planned(nmpc, nodes):
    """Return the command, and nodes, γ and tensions that the model has along the plan.

    From the node positions of the states, by the law of the strings; no matrix of the program.
    """
    command = nmpc.command(0.0, nodes, STILL)
    plant = nmpc.plant
    states = [plant.measure(nodes, STILL)]
    for u in nmpc.plan.T:
        states.append(np.array(nmpc.sampled(states[-1], u)).ravel())
    shapes = np.array([with_bar_lengths(plant, plant.to_nodes(z[:9])) for z in states])
    length = np.array([plant.model.structure.string_length(N) for N in shapes])
    gamma = nmpc.plan.T
    if plant.input == "rest_length":
        gamma = 200.0 * (1 - nmpc.plan.T / length[:-1])  # k (l − l0)/l, negative where slack
    return command, shapes, gamma, gamma * length[:-1]


def with_bar_lengths(plant, nodes):
    """Return nodes moved by plain iteration along the bars of the operating point."""
    structure, nodes = plant.model.structure, nodes.copy()
    axes = structure.bar_vectors(plant.nodes) / structure.bar_length
    for bar, (start, end) in enumerate(structure.bars):
        for _ in range(50):
            vector = nodes[:, end] - nodes[:, start]
            short = structure.bar_length[bar] - np.linalg.norm(vector)
            nodes[:, start] -= 0.5 * short * axes[:, bar]
            nodes[:, end] += 0.5 * short * axes[:, bar]
    return nodes


def test_derivatives_of_limited_rows(plant):
    nmpc = NMPC(
        plant,
        horizon=3,
        sample_time=SAMPLE,
        max_force_density=60.0,
        max_tension=40.0,
        outputs=[OutputLimit(height_row(), 0.9)],
    )
    rows = limited_rows(plant, constraints_of(nmpc))
    rng = np.random.default_rng(0)
    z, later, dz, dl = (1e-2 * rng.normal(size=18) for _ in range(4))
    u, du = plant.equilibrium_input, 1e-3 * rng.normal(size=9)
    h = 1e-4
    _, by_z, by_u, by_later = (part.full() for part in rows(z, u, later))
    ends = [rows(z + s * dz, u + s * du, later + s * dl)[0].full().ravel() for s in (h, -h)]
    slope = (ends[0] - ends[1]) / (2 * h)
    assert np.allclose(slope, by_z @ dz + by_u @ du + by_later @ dl, rtol=1e-6, atol=1e-7)


def constraints_of(nmpc):
    from tenscontrol.control.mpc.settings import MPCSettings, design

    limits = (OutputLimit(height_row(), 0.9),)
    settings = MPCSettings(
        horizon=3,
        sample_time=SAMPLE,
        max_force_density=60.0,
        max_tension=40.0,
        outputs=limits,
        string_penalty=1.0,
    )
    return design(nmpc.plant, settings).constraints


@pytest.mark.parametrize("penalty", [None, np.inf])
def test_program_satisfies_the_optimality_conditions(plant, penalty):
    limit = OutputLimit(height_row(), low=0.995, high=1.004, penalty=1e4)
    nmpc = NMPC(
        plant,
        horizon=5,
        sample_time=SAMPLE,
        max_force_density=60.0,
        max_tension=40.0,
        outputs=[limit],
        string_penalty=penalty,
        max_change=None if penalty else 5.0,
        tolerance=1e-8,
        max_iterations=50000,
        solver="osqp",
    )
    found, multipliers = optimality(nmpc, pushed(plant, 0.01), STILL)
    assert found < 1e-6 * max(1.0, np.abs(multipliers).max())


def test_strength_of_strings_is_kept_and_matters(plant):
    nodes = pushed(plant, 0.02)
    free, *_, tension = planned(
        NMPC(plant, horizon=6, sample_time=SAMPLE, max_force_density=300.0, **EXACT), nodes
    )
    limit = max(0.5 * (tension[1:].max() + 30.1), 1.001 * tension[0].min())
    held = NMPC(
        plant, horizon=6, sample_time=SAMPLE, max_force_density=300.0, max_tension=limit, **EXACT
    )
    command, _, _, kept = planned(held, nodes)
    assert command.status == "ok"
    assert tension.max() > limit * 1.001
    assert kept.max() < limit * (1 + 2e-4)
    assert np.abs(command.value - free.value).max() > 0


def test_least_force_density_is_kept(plant):
    nodes = pushed(plant, 0.02)
    weight = 1e-3 if plant.input == "force_density" else None
    gammas = [
        planned(
            NMPC(
                plant,
                horizon=6,
                sample_time=SAMPLE,
                max_force_density=60.0,
                min_force_density=least,
                R=weight,
                **EXACT,
            ),
            nodes,
        )[2]
        for least in (0.0, 14.0)
    ]
    assert gammas[0].min() < 14.0
    assert gammas[1].min() > 14.0 - 0.01


def test_soft_output_limit_that_can_be_kept_is_the_hard_one(plant):
    """The L1 penalty is exact; the limit holds on the nonlinear shape, bars at their lengths."""
    nodes = pushed(plant, 0.02)
    row = height_row()

    def heights(shapes):
        return shapes.transpose(0, 2, 1).reshape(len(shapes), -1)[1:] @ row[0]

    free = heights(
        planned(
            NMPC(plant, horizon=6, sample_time=SAMPLE, max_force_density=300.0, **EXACT), nodes
        )[1]
    )
    bound = 1.0 + 0.7 * (free.max() - 1.0)
    values = []
    for penalty in (None, 1e7):
        limit = OutputLimit(row, high=bound, penalty=penalty)
        nmpc = NMPC(
            plant, horizon=6, sample_time=SAMPLE, max_force_density=300.0, outputs=[limit], **EXACT
        )
        command, shapes, *_ = planned(nmpc, nodes)
        assert command.status == "ok"
        assert heights(shapes).max() < bound + 2e-5
        values.append(command.value)
    assert np.allclose(*values, atol=1e-3 * (30.0 if plant.input == "force_density" else 0.1))


def test_program_pays_only_for_the_limits_that_it_has(plant):
    if plant.input == "force_density":
        plain, limited = (
            NMPC(
                plant,
                horizon=4,
                sample_time=SAMPLE,
                max_force_density=60.0,
                max_tension=most,
                solver="osqp",
            )._plan.program.form
            for most in (None, 50.0)
        )
        assert plain.A.shape == (4 * 27, 4 * 27)
        # Tension from above alone, and one violation each: of z_k (k ≥ 1), of u_k, of itself.
        assert limited.A.shape == (4 * 27 + 2 * 4 * 9, 4 * 36)
        assert limited.A.nnz - plain.A.nnz == 3 * 81 + 4 * 9 + 2 * 4 * 9
    else:
        program = NMPC(plant, horizon=4, sample_time=SAMPLE, solver="osqp")._plan.program.form
        assert program.A.shape == (4 * 18 + 4 * 9 + 2 * 4 * 9, 4 * 36)


@pytest.mark.parametrize("gain", [None, 0.3])
def test_unknown_load_leaves_no_offset_where_it_is_estimated(gain):
    """On the 36 states of a loaded model, which the controller does not know."""
    prism = tc.prism()
    pull = np.zeros((3, 6))
    pull[2, :3], pull[2, 3:] = 2 / 3, -2 / 3
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, demo.TOP_FORCE_DENSITY))
    tracked = None if gain is None else height_row()
    nmpc = NMPC(
        plant,
        horizon=6,
        sample_time=SAMPLE,
        max_force_density=80.0,
        load_gain=gain,
        tracked=tracked,
    )
    loaded = tc.Model(prism, external_force=pull)
    run = tc.simulate(loaded, 6.0, controller=nmpc, step=5e-3, output_step=0.2)
    assert set(nmpc.statistics.status_count) == {"ok"}
    shapes = [plant.to_nodes(plant.measure(run.nodes[:, :, -1], run.velocities[:, :, -1])[:9])]
    off = abs(demo.height_of(np.stack(shapes, axis=-1))[0] - 1.0)
    if gain is None:
        assert off > 2e-3
        assert nmpc.load is None
    else:
        assert off < 2e-4
        expected = plant.basis.T @ pull.ravel(order="F")
        assert np.linalg.norm(nmpc.load - expected) < 0.15 * np.linalg.norm(expected)
        nmpc.reset()
        assert not nmpc.load.any()


@pytest.mark.parametrize(("arguments", "message"), [
    ({"min_force_density": -1.0}, "min_force_density"),
    ({"min_force_density": 50.0}, r"min_force_density\[0\]"),
    ({"max_tension": 1.0}, "max_tension"),
    ({"string_penalty": -1.0}, "string_penalty"),
    ({"load_gain": 2.0}, "load_gain"),
    ({"tracked": np.ones((1, 18))}, "needs load_gain"),
])  # fmt: skip
def test_limits_that_do_not_fit_are_refused(arguments, message):
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, demo.TOP_FORCE_DENSITY))
    with pytest.raises(ValueError, match=message):
        NMPC(plant, horizon=4, sample_time=SAMPLE, max_force_density=60.0, **arguments)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"outputs": [3.0]}, r"outputs\[0\]"),
    ({"machine_code": 1.0}, "machine_code"),
])  # fmt: skip
def test_arguments_of_the_wrong_kind_are_refused(arguments, message):
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, demo.TOP_FORCE_DENSITY))
    with pytest.raises(TypeError, match=message):
        NMPC(plant, horizon=4, sample_time=SAMPLE, max_force_density=60.0, **arguments)
