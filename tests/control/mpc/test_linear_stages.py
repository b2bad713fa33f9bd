"""Linear MPC along the stages gives the inputs of the optimum of its program."""

import pickle
import warnings

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control.mpc import OutputLimit
from tests.control.mpc.optimum import exact_optimum, point_of_inputs
from tests.marks import needs_core

pytestmark = needs_core


def plant_of(structure, held):
    rest = tc.prestress(structure, min_force_density=5.0)
    strings = tc.LinearStrings(stiffness=1e3) if held == "rest_length" else None
    return tc.linearize(tc.Model(rest.structure, strings=strings), rest, input=held)


def moved(plant, size):
    """Return a reference that moves to another shape in 0.1 s."""
    q = size * np.random.default_rng(1).normal(size=plant.degrees_of_freedom)
    shapes = [plant.to_nodes(share * q) for share in np.linspace(0, 1, 6)]
    return tc.Reference(np.linspace(0.0, 0.1, 6), np.stack(shapes, axis=-1))


def with_weights(plant, given, terminal):
    """Return settings with a cross weight that the cost allows, and a terminal weight."""
    Q, R = tc.plant.natural_weights(plant)
    root = np.linalg.cholesky(Q) * 0.9 / np.sqrt(len(Q))
    N = root @ np.random.default_rng(3).uniform(-1, 1, (len(Q), len(R))) * np.sqrt(R)
    return given | {"N": N / np.sqrt(len(R))} | ({"terminal_weight": 3 * Q} if terminal else {})


def scene(name):
    """Return a plant, settings and the size of a push."""
    if name.endswith("own weights"):
        plant, given, size = scene(name.removesuffix(", own weights"))
        return plant, with_weights(plant, given, terminal="along" not in name), size
    if name == "tower":
        plant = plant_of(tc.prism_tower(2), "rest_length")
        return plant, {"winches": tc.Winches(rate=0.1), "max_tension": 1e3}, 0.005
    if name == "few modes":
        plant = tc.reduce(plant_of(tc.prism_tower(2), "rest_length"), 4)
        Q, R = tc.energy_weights(plant, by_mode=True)
        given = {"winches": tc.Winches(rate=0.02), "Q": Q, "R": R}
        return plant, given | {"reference": moved(plant, 0.003), "load_gain": 0.5}, 0.02
    if name == "few modes, limited outputs":
        plant = tc.reduce(plant_of(tc.prism_tower(2), "rest_length"), 4)
        rows = np.zeros((2, plant.nodes.size))
        rows[0, [2, -1]], rows[1, [1, 7]] = (1.0, -1.0), (1.0, -1.0)
        here = rows @ plant.nodes.ravel(order="F")
        limits = [OutputLimit(rows, low=here - 1e-3, high=here + 1e-3, penalty=1e4)]
        given = {"winches": tc.Winches(rate=0.02), "max_tension": 1e3, "outputs": limits}
        return plant, given, 0.02
    if name == "few modes, hard limits":
        plant = tc.reduce(plant_of(tc.prism_tower(2), "rest_length"), 4)
        return plant, {"min_force_density": 1.0, "string_penalty": np.inf}, 0.02
    if name == "ball":
        plant = plant_of(tc.library.six_bar_ball(bar_length=1.0), "force_density")
        largest = float(plant.force_density.max())
        row = np.zeros((1, 3 * plant.nodes.shape[1]))
        row[0, [2, 5]] = 1.0, -1.0
        here = float(row[0] @ plant.nodes.ravel(order="F"))
        limits = [OutputLimit(row, high=here + 1e-3, penalty=1e4)]
        given = {"max_force_density": 1.5 * largest, "max_change": 0.2 * largest}
        return plant, given | {"outputs": limits, "load_gain": 0.5}, 0.02
    if name == "along a reference":
        plant = plant_of(tc.library.class2_tower(2), "rest_length")
        return plant, {"winches": tc.Winches(rate=0.1), "reference": moved(plant, 0.003)}, 0.003
    plant = plant_of(tc.library.d_bar(), "rest_length")
    winches = tc.Winches(rate=0.1, substeps=10)
    return plant, {"winches": winches, "reference": moved(plant, 0.003), "load_gain": 1.0}, 0.003


@pytest.mark.parametrize(
    "name",
    [
        "tower", "ball", "along a reference", "plane, ramps and load",
        "few modes, limited outputs", "few modes, hard limits", "ball, own weights",
        "plane, ramps and load, own weights", "few modes, hard limits, own weights",
    ],
)  # fmt: skip
def test_inputs_are_those_of_the_optimum(name):
    plant, given, size = scene(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a ball, which twists as it likes
        mpc = tc.MPC(plant, horizon=6, sample_time=0.02, **given)
    inputs_are_those_of_the_optimum(plant, mpc, size)


def test_inputs_of_a_horizon_with_too_many_limits_for_a_map_from_the_state():
    plant, given, size = scene("tower")
    mpc = tc.MPC(plant, horizon=60, sample_time=0.02, **given)
    inputs_are_those_of_the_optimum(plant, mpc, 0.5 * size, samples=2)


def inputs_are_those_of_the_optimum(plant, mpc, size, samples=10):
    assert mpc.solver == "stages"
    rng, active = np.random.default_rng(0), 0
    level = mpc.law.design.problem.level
    for k in range(samples):
        if k == 5:  # a copy is prepared anew, and goes on
            mpc = pickle.loads(pickle.dumps(mpc))
        # Measured is what another structure may do: pushes now and then, still in between.
        push = size * rng.normal(size=(2, plant.degrees_of_freedom)) * (k in (0, 1, 6))
        nodes = plant.to_nodes(push[0])
        speeds = (plant.basis @ push[1]).reshape(nodes.shape, order="F")
        program = mpc.program(0.02 * k, nodes, speeds)
        command = mpc.command(0.02 * k, nodes, speeds)
        assert command.status == "ok"
        near = point_of_inputs(program, mpc.plan)
        exact = exact_optimum(program.P, program.q, program.A, program.l, program.u, near)
        np.testing.assert_allclose(mpc.plan, program.inputs(exact), rtol=0, atol=1e-9 * level)
        np.testing.assert_allclose(mpc.plan[:, 0], command.value, rtol=1e-13)
        active += mpc.statistics.iterations[-1]
    assert active > 5


def test_memory_of_few_modes_grows_as_their_inputs():
    inputs, sizes = [], []
    for stages in (8, 16):
        plant = tc.reduce(plant_of(tc.prism_tower(stages), "rest_length"), 4)
        _, R = tc.energy_weights(plant, by_mode=True)
        given = {"winches": tc.Winches(rate=0.02), "R": np.diag(R)}
        mpc = tc.MPC(plant, horizon=20, sample_time=0.02, **given)
        problem, numbers = mpc.law.design.problem, mpc._program._core._memory[0]
        assert problem.input_weight.shape == plant.B.shape[1:]
        assert problem.rows.by_input.nnz == plant.B.shape[1]
        inputs.append(plant.B.shape[1])
        sizes.append(len(numbers))
    # The rows that may be active at once are as many: factors of 5,000.
    assert (sizes[1] - sizes[0]) / (inputs[1] - inputs[0]) < 20 * 100


def test_a_program_without_solution_is_told_and_forgotten():
    plant, given, size = scene("tower")
    law = tc.MPC(plant, horizon=6, sample_time=0.02, max_iterations=1, **given)
    q = 5 * size * np.random.default_rng(0).normal(size=plant.degrees_of_freedom)
    still = np.zeros_like(plant.nodes)
    assert law.command(0.0, plant.to_nodes(q), still).status == "out of iterations"
    command = law.command(0.02, plant.nodes, still)
    assert command.status == "ok"
    np.testing.assert_allclose(command.value, plant.equilibrium_input, atol=1e-12)


def test_most_changes_grow_with_the_limits_where_no_number_is_asked_for(monkeypatch):
    monkeypatch.setattr("tenscontrol.control.mpc.stages.MOST_ITERATIONS", 1)
    plant, given, size = scene("tower")
    law = tc.MPC(plant, horizon=6, sample_time=0.02, **given)
    q = size * np.random.default_rng(0).normal(size=plant.degrees_of_freedom)
    assert law.command(0.0, plant.to_nodes(q), np.zeros_like(plant.nodes)).status == "ok"
    assert law.statistics.iterations[0] > 1
