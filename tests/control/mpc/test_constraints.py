"""Limits of MPC on strings and outputs, hard and soft."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import OutputLimit, Status
from tests.known_structures import height_row, lowered

SAMPLE = 0.02
STILL = np.zeros((3, 6))


@pytest.fixture(scope="module", params=["force_density", "rest_length"])
def plant(request):
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(200.0))
    return tc.linearize(model, tc.prestress(prism, 30 / np.sqrt(3)), input=request.param)


def pushed(plant, size, seed=0):
    return plant.to_nodes(size * np.random.default_rng(seed).normal(size=9))


def solved(mpc, nodes, velocities=STILL):
    """Return the command, and z_0 … z_N as predicted with the plan."""
    command = mpc.command(0.0, nodes, velocities)
    transition, inputs, _ = mpc.plant.discretize(SAMPLE)
    z = [mpc.plant.measure(nodes, velocities)]
    for v in (mpc.plan - mpc.plant.equilibrium_input[:, None]).T:
        z.append(transition @ z[-1] + inputs @ v)
    return command, np.array(z)


def predicted(mpc, name, z):
    """Return γ or tension at the start of each sample of a plan, shape (N, α)."""
    from tenscontrol.plant.string_outputs import string_map

    found = string_map(mpc.plant, mpc.plant.input)
    v = (mpc.plan - mpc.plant.equilibrium_input[:, None]).T
    start = found.force_density if name == "gamma" else found.tension
    by_z, by_v = (getattr(found, f"{name}_by_{what}") for what in ("state", "input"))
    return start + z[:-1] @ by_z.T + v @ by_v.T


@pytest.mark.parametrize("penalty", [None, np.inf])
def test_solution_satisfies_the_optimality_conditions(plant, penalty):
    from tests.control.mpc.test_linear import kkt_residual

    limit = OutputLimit(height_row(), low=0.995, high=1.004, penalty=1e4)
    mpc = tc.MPC(
        plant,
        horizon=6,
        sample_time=SAMPLE,
        max_force_density=60.0,
        solver="osqp",
        max_tension=40.0,
        outputs=[limit],
        string_penalty=penalty,
        tolerance=1e-8,
        max_iterations=50000,
    )
    program, form, solver = {}, mpc._program.form, mpc._program.solver
    solve = solver.solve

    def kept(q, l, u, start=None, **_):  # noqa: E741
        program["data"], program["answer"] = (q, l, u), solve(q, l, u, start)
        return program["answer"]

    solver.solve = kept
    mpc.command(0.0, pushed(plant, 0.01), STILL)
    answer, (q, l, u) = program["answer"], program["data"]  # noqa: E741
    assert answer.status is Status.OK
    scale = max(1.0, np.abs(answer.y).max())
    far = 1e9  # for infinity, which times zero is nothing
    low, high = np.clip(l, -far, far), np.clip(u, -far, far)
    residual = kkt_residual(form.P, q, form.A, low, high, answer.x, answer.y)
    assert residual < 1e-6 * scale


def test_violations_cost_what_the_docstrings_say(plant):
    """A price times (2 ε + ε²), for strings in costs of an input that is off by its unit."""
    row, penalty = height_row(), 1e4
    mpc = tc.MPC(
        plant, horizon=2, sample_time=SAMPLE, max_force_density=60.0,
        max_tension=40.0, outputs=[OutputLimit(row, low=0.995, penalty=penalty)],
        string_penalty=50.0,
    )  # fmt: skip
    program = mpc.program(0.0, plant.nodes, STILL)
    problem = mpc.law.design.problem
    # A program is half of the cost, over that of an input off by its unit.
    unit = problem.level**2 * problem.input_weight.min()
    u = 0.01 * np.linalg.norm(row) * np.ptp(plant.nodes, axis=1).max()
    strings = len(problem.rows.soft) - 1
    # π (2 e + e²/u) is π u (2 ε + ε²).
    expected = np.tile(np.r_[np.full(strings, 50.0), penalty * u / unit], 2)
    np.testing.assert_allclose(program.q[-len(expected) :], expected)
    np.testing.assert_allclose(program.P.diagonal()[-len(expected) :], expected)


def test_both_solvers_give_the_same_commands(plant):
    limit = OutputLimit(height_row(), low=0.995, high=1.004, penalty=1e4)
    values = [
        tc.MPC(
            plant,
            horizon=6,
            sample_time=SAMPLE,
            max_force_density=60.0,
            solver=solver,
            max_tension=40.0,
            outputs=[limit],
            tolerance=1e-8,
            max_iterations=50000,
        )
        .command(0.0, pushed(plant, 0.02), STILL)
        .value
        for solver in ("auto", "osqp")
    ]
    level = 30.0 if plant.input == "force_density" else 0.1
    assert np.allclose(*values, atol=1e-5 * level)


def test_strength_of_strings_is_kept_and_matters(plant):
    nodes = pushed(plant, 0.02)
    free, z = solved(
        tc.MPC(plant, horizon=8, sample_time=SAMPLE, max_force_density=300.0, tolerance=1e-7), nodes
    )
    highest = predicted(mpc_with(plant, None, nodes), "tension", z).max()
    limit = 0.5 * (highest + 31.0)
    assert highest > limit  # the case is worth something
    held = tc.MPC(
        plant,
        horizon=8,
        sample_time=SAMPLE,
        max_force_density=300.0,
        max_tension=limit,
        tolerance=1e-7,
        max_iterations=20000,
    )
    command, z = solved(held, nodes)
    assert predicted(held, "tension", z).max() < limit * (1 + 1e-4)
    assert np.abs(command.value - free.value).max() > 0


def mpc_with(plant, limit, nodes):
    mpc = tc.MPC(
        plant,
        horizon=8,
        sample_time=SAMPLE,
        max_force_density=300.0,
        max_tension=limit,
        tolerance=1e-7,
        max_iterations=20000,
    )
    mpc.command(0.0, nodes, STILL)
    return mpc


def test_soft_limit_that_can_be_kept_is_the_hard_one(plant):
    """The penalty is exact: L1 costs more than any gain from a violation."""
    nodes = pushed(plant, 0.02)
    z = solved(mpc_with(plant, None, nodes), nodes)[1]
    height = 1.0 + (z[1:, :9] @ (height_row() @ plant.basis).T).ravel()
    bound = 1.0 + 0.7 * (height.max() - 1.0)
    values = []
    for penalty in (None, 1e7):
        limit = OutputLimit(height_row(), high=bound, penalty=penalty)
        mpc = tc.MPC(
            plant,
            horizon=8,
            sample_time=SAMPLE,
            max_force_density=300.0,
            outputs=[limit],
            tolerance=1e-7,
            max_iterations=50000,
        )
        command, z = solved(mpc, nodes)
        assert command.status == "ok"
        kept = 1.0 + (z[1:, :9] @ (height_row() @ plant.basis).T).ravel()
        assert kept.max() < bound + 1e-5
        values.append(command.value)
    level = 30.0 if plant.input == "force_density" else 0.1
    assert np.allclose(*values, atol=1e-3 * level)


@pytest.mark.parametrize("law", [tc.MPC, tc.NMPC])
def test_limit_out_of_reach_is_violated_softly_or_reported_when_hard(plant, law):
    low = lowered(0.97)
    for penalty, status in ((1e3, "ok"), (None, "infeasible")):
        limit = OutputLimit(height_row(), low=0.999, penalty=penalty)  # after one sample already
        controller = law(
            plant,
            horizon=4,
            sample_time=SAMPLE,
            max_force_density=60.0,
            outputs=[limit],
            max_change=1e-3,
        )
        assert controller.command(0.0, low, STILL).status.split(":")[0] == status


@pytest.mark.parametrize("law", [tc.MPC, tc.NMPC])
def test_a_hard_limit_that_the_operating_point_or_the_reference_breaks_is_refused(plant, law):
    """Before, each program was infeasible, or the loop stopped short, without a word."""
    usual = {"horizon": 4, "sample_time": SAMPLE, "max_force_density": 60.0}
    above, below = OutputLimit(height_row(), low=1.02), OutputLimit(height_row(), low=0.9)
    with pytest.raises(
        ValueError, match=r"outputs\[1\]\.low is 1\.02 m for row 0, but the operating"
    ):
        law(plant, outputs=[below, above], **usual)
    far = tc.Reference([0.0, 1.0], np.stack([plant.nodes, lowered(0.85)], axis=-1))
    with pytest.raises(ValueError, match=r"the reference at 1 s has 0\.85 m, 0\.05 m beyond"):
        law(plant, outputs=[below], reference=far, **usual)
    follows = law(plant, outputs=[below], **usual)
    with pytest.raises(ValueError, match=r"the reference at 1 s"):
        follows.follow(far)
    follows.follow(lowered(0.95))
    soft = OutputLimit(height_row(), low=0.9, penalty=10.0)
    with pytest.warns(tc.control.ControlWarning, match="0.05 m beyond") as caught:
        law(plant, outputs=[soft], reference=far, **usual)
    assert caught[0].filename == __file__


def test_hard_limits_of_strings_hold_along_the_reference():
    prism = tc.prism()
    plant = tc.linearize(
        tc.Model(prism, strings=tc.LinearStrings(200.0)), tc.prestress(prism, 20.0),
        input="rest_length",
    )  # fmt: skip
    usual = {"horizon": 4, "sample_time": SAMPLE, "string_penalty": np.inf}
    with pytest.raises(
        ValueError, match=r"min_force_density is 25 N/m for string [0-5], but the op"
    ):
        tc.MPC(plant, min_force_density=25.0, **usual)
    tall, gamma = plant.nodes[:, :, None] * [1.0, 1.0], np.outer(plant.force_density, [1.0, 2.0])
    rising = tc.Reference([0.0, 1.0], tall, gamma)
    tc.MPC(plant, max_force_density=80.0, reference=rising, **usual)
    with pytest.raises(
        ValueError, match=r"max_force_density is 50 .*string [678], but the ref.* at 1 s"
    ):
        tc.MPC(plant, max_force_density=50.0, reference=rising, **usual)
    with pytest.raises(ValueError, match=r"max_tension .* the reference at 1 s"):
        tc.MPC(plant, max_tension=45.0, reference=rising, **usual)


def test_least_force_density_is_kept(plant):
    mpc = tc.MPC(
        plant,
        horizon=8,
        sample_time=SAMPLE,
        max_force_density=60.0,
        min_force_density=14.0,
        tolerance=1e-6,
        R=1e-3 if plant.input == "force_density" else None,
    )
    nodes = pushed(plant, 0.02)
    _, z = solved(mpc, nodes)
    found = predicted(mpc, "gamma", z)
    assert found.min() > 14.0 - 0.05
    free = tc.MPC(
        plant,
        horizon=8,
        sample_time=SAMPLE,
        max_force_density=60.0,
        tolerance=1e-6,
        R=1e-3 if plant.input == "force_density" else None,
    )
    _, z = solved(free, nodes)
    assert predicted(free, "gamma", z).min() < 14.0


@pytest.mark.parametrize(("arguments", "message"), [
    ({"max_tension": 10.0}, "max_tension is 10 N for string"),
    ({"max_tension": -1.0}, "max_tension"),
    ({"min_force_density": -1.0}, "min_force_density"),
    ({"string_penalty": 0.0}, "string_penalty"),
    ({"load_gain": 2.0}, "load_gain"),
    ({"tracked": np.zeros((1, 18))}, "load_gain"),
    ({"load_gain": 0.1, "tracked": np.zeros((1, 4))}, "tracked has shape"),
    ({"outputs": [OutputLimit(np.ones((1, 4)))]}, "matrix has shape"),
])  # fmt: skip
def test_limits_that_do_not_fit_are_refused(plant, arguments, message):
    with pytest.raises(ValueError, match=message):
        tc.MPC(plant, horizon=4, sample_time=SAMPLE, max_force_density=60.0, **arguments)


def test_winches_belong_to_rest_lengths(plant):
    if plant.input == "force_density":
        with pytest.raises(ValueError, match="input='rest_length'"):
            tc.MPC(
                plant,
                horizon=4,
                sample_time=SAMPLE,
                max_force_density=60.0,
                winches=tc.Winches(rate=1.0),
            )
    else:
        with pytest.raises(ValueError, match="range of the winches"):
            tc.MPC(plant, horizon=4, sample_time=SAMPLE, winches=tc.Winches(shortest=2.0))


@pytest.mark.parametrize(("arguments", "message"), [
    ({"matrix": np.zeros((1, 1, 18))}, "matrix has shape"),
    ({"matrix": np.zeros((1, 18))}, "row of zeros"),
    ({"matrix": np.ones((1, 18)), "low": 1.0, "high": 0.0}, "exceeds"),
    ({"matrix": np.ones((1, 18)), "penalty": 0.0}, "penalty"),
])  # fmt: skip
def test_output_limits_are_checked(arguments, message):
    with pytest.raises(ValueError, match=message):
        OutputLimit(**arguments)
