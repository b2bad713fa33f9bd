"""Plants some of whose strings are driven, beside their parts and a staircase."""

from itertools import combinations

import control
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.actuation.driven_strings import bounds_of_inputs, changes_of_inputs
from tests.plant.scenes import INPUTS, prism_plant
from tests.plant.test_command_parents import massive_plant

BALL = tc.library.six_bar_ball()
MODEL = tc.Model(BALL, strings=tc.LinearStrings(stiffness=1e3, damping=2.0))
SQUARE = tc.Model(BALL, strings=tc.LinearStrings(stiffness=1e3))
REST = tc.prestress(BALL, min_force_density=20.0)
PAIRS = {f"pair{i}": [2 * i, 2 * i + 1] for i in range(6)}


def ball_plant(actuated=None, model=MODEL, input="rest_length", **options):
    return tc.linearize(model, REST, input=input, actuated=actuated, **options)


def staircase(A, B, tolerance=1e-9):
    """Return an orthonormal basis of what B reaches under A: one block of columns after another."""
    A = A / np.linalg.norm(A, 2)
    basis, fresh = np.zeros((len(A), 0)), B / np.linalg.norm(B, 2)
    while True:
        for _ in range(2):  # twice is enough
            fresh = fresh - basis @ (basis.T @ fresh)
        U, sizes, _ = np.linalg.svd(fresh, full_matrices=False)
        fresh = U[:, sizes > tolerance]
        if not fresh.shape[1]:
            return basis
        basis = np.hstack([basis, fresh])
        fresh = A @ fresh


@pytest.mark.parametrize("held", INPUTS)
def test_driven_columns_are_those_of_the_whole_plant(rest, held):
    whole = prism_plant(rest, held)
    some = tc.linearize(whole.model, rest, input=held, actuated=[8, "top"])
    np.testing.assert_array_equal(some.A, whole.A)
    np.testing.assert_array_equal(some.B, whole.B[:, [8, 0, 1, 2]])
    np.testing.assert_array_equal(some.equilibrium_input, whole.equilibrium_input[[8, 0, 1, 2]])
    np.testing.assert_array_equal(some.string_values, whole.equilibrium_input)
    assert some.input_names == [whole.input_names[i] for i in (8, 0, 1, 2)]
    np.testing.assert_array_equal(some.actuation.passive, [3, 4, 5, 6, 7])
    assert some.to_statespace().ninputs == 4


def test_ganged_strings_move_by_their_ratios(rest):
    whole = prism_plant(rest, "rest_length")
    groups = {"lid": "top", "seesaw": {3: 0.5, 4: -1.0}, "one": 8}
    some = tc.linearize(whole.model, rest, input="rest_length", actuated=groups)
    G = np.zeros((9, 3))
    G[[0, 1, 2], 0], G[3, 1], G[4, 1], G[8, 2] = 1.0, 0.5, -1.0, 1.0
    np.testing.assert_allclose(some.B, whole.B @ G, rtol=0, atol=1e-12 * np.abs(whole.B).max())
    by_matrix = tc.linearize(whole.model, rest, input="rest_length", actuated=G)
    np.testing.assert_array_equal(by_matrix.B, some.B)
    assert some.input_names == ["rest_length_lid", "rest_length_seesaw", "rest_length_one"]
    assert by_matrix.input_names[1] == "rest_length_bottom[0]"
    l0, moves = whole.rest_length, np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(some.equilibrium_input, [l0[0], 2 * l0[3], l0[8]])
    moved = some.actuation.strings(some.equilibrium_input + moves)
    expected = l0 + np.array([0.1, 0.1, 0.1, 0.1, -0.2, 0, 0, 0, 0.3])
    np.testing.assert_allclose(moved, expected, atol=1e-15)
    np.testing.assert_allclose(some.actuation.inputs(moved), some.equilibrium_input + moves)
    again = tc.linearize(whole.model, rest, input="rest_length", actuated=some.actuation)
    np.testing.assert_array_equal(again.B, some.B)


def test_inputs_have_the_tightest_bounds_of_their_strings(rest):
    groups = {"seesaw": {3: 0.5, 4: -1.0}, "one": 8}
    some = tc.linearize(tc.Model(tc.prism()), rest, actuated=groups)
    low, high = bounds_of_inputs(some.actuation, np.full(9, 5.0), np.full(9, 40.0))
    inputs = np.random.default_rng(0).uniform(low - 20, high + 20, (2000, 2))
    strings = np.array([some.actuation.strings(u) for u in inputs])[:, [3, 4, 8]]
    within = ((strings >= 5.0) & (strings <= 40.0)).all(axis=1)
    np.testing.assert_array_equal(within, ((inputs >= low) & (inputs <= high)).all(axis=1))
    change = changes_of_inputs(some.actuation, np.full(9, 1.0))
    np.testing.assert_array_equal(change, [1.0, 1.0])  # string 3 alone could do 2


@pytest.mark.parametrize("model", [MODEL, SQUARE])
@pytest.mark.parametrize("held", INPUTS)
@pytest.mark.parametrize("actuated", [None, range(12), PAIRS, [0], [0, 1, 2, 3]])
def test_what_is_reached_agrees_with_a_staircase(model, held, actuated):
    plant = ball_plant(actuated, model, held)
    unit = np.r_[np.full(plant.degrees_of_freedom, 1 / plant.spectral_radius), np.ones(24)]
    reached = staircase(plant.A * unit / unit[:, None], plant.B / unit[:, None], 1e-7)
    assert tc.controllability(plant).unreachable == len(plant.A) - reached.shape[1]


@pytest.mark.parametrize("actuated", [range(12), PAIRS])
def test_other_coordinates_and_fewer_modes_keep_the_winches(actuated):
    plant = ball_plant(actuated)
    minimal = tc.plant.in_coordinates(plant, "minimal")
    np.testing.assert_allclose(minimal.B, ball_plant(actuated, coordinates="minimal").B)
    small = tc.reduce(plant, 10)
    assert small.B.shape == (20, plant.B.shape[1])
    assert small.actuation is plant.actuation


def test_whole_strings_of_a_subdivision_are_driven_by_their_own_numbers():
    plant = massive_plant("rest_length")
    whole = tc.plant.command_parents(plant)
    some = tc.plant.command_parents(plant, actuated=["vertical", 0])
    np.testing.assert_array_equal(some.B, whole.B[:, [6, 7, 8, 0]])
    np.testing.assert_allclose(tc.plant.in_coordinates(some, "internal").B, some.B, atol=1e-9)
    at = tc.OperatingPoint(plant.nodes, plant.force_density)
    segments = tc.linearize(plant.model, at, input="rest_length", actuated=[0])
    with pytest.raises(ValueError, match="names segments of strings"):
        tc.plant.command_parents(segments)
    with pytest.raises(ValueError, match="one of whole strings already"):
        tc.plant.command_parents(some, actuated=[0])


@pytest.mark.parametrize(
    ("actuated", "match"),
    [
        ([], "actuated is empty"),
        ([9], r"actuated\[0\] is 9, expected 0 to 8"),
        (["lid"], r"actuated\[0\] is 'lid', expected one of 'top', 'bottom', 'vertical'"),
        ([[0, 1], [2]], "has a list in a list"),
        ({"a": [0, 1], "b": [1]}, r"actuated\['b'\] has string 1, which another winch drives"),
        ({"a": {0: -1.0}}, r"actuated\['a'\] has no string with a positive ratio"),
        ({"a": {0: 0.0}}, "by which nothing moves"),
        ({"a": {"top": 1.0, 0: 2.0}}, "has string 0 twice"),
        ({"not a name": [0]}, "expected a name"),
        (np.ones((9, 2)), "which another winch drives"),
        (np.eye(8), r"has shape \(8, 8\), expected \(9, m\)"),
        (np.eye(9)[:, :2] * [1.0, 0.0], "a column of zeros, 1"),
    ],
)
def test_what_cannot_be_meant_is_refused(rest, actuated, match):
    with pytest.raises(ValueError, match=match):
        tc.linearize(tc.Model(tc.prism()), rest, actuated=actuated)


def test_masks_ranges_and_arrays_name_strings(rest):
    model = tc.Model(tc.prism())
    expected = tc.linearize(model, rest, actuated=[6, 7, 8]).B
    mask = np.arange(9) > 5
    for form in (mask, range(6, 9), np.array([6, 7, 8]), "vertical", (6, 7, 8), ["vertical", 7]):
        np.testing.assert_array_equal(tc.linearize(model, rest, actuated=form).B, expected)


# ---- which strings are worth a motor ----


@pytest.mark.parametrize("held", INPUTS)
def test_the_choice_says_what_its_strings_reach(held):
    plant = ball_plant(None, SQUARE, held)
    choice = tc.actuator_choice(plant, count=8)
    assert (np.diff(choice.unreachable) <= 0).all()
    for count in (1, 4, 8):
        some = ball_plant(choice.string[:count], SQUARE, held)
        assert tc.controllability(some).unreachable == choice.unreachable[count - 1]
    assert len(choice.table().splitlines()) == 9


def test_the_choice_is_near_the_best_of_all():
    """Of three strings of the prism, by the log determinant of the exact Gramian."""
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0, damping=1.0))
    plant = tc.linearize(model, tc.prestress(tc.prism(), 17.3205), input="rest_length")

    def worth(strings):
        B = plant.B[:, list(strings)]
        gramian = control.lyap(plant.A, B @ B.T)
        return np.linalg.slogdet(gramian)[1]

    best = max(map(worth, combinations(range(9), 3)))
    least = min(map(worth, combinations(range(9), 3)))
    greedy = worth(tc.actuator_choice(plant, count=3).string)
    assert greedy > best - 0.05 * (best - least)


def test_ganged_inputs_are_chosen_whole():
    choice = tc.actuator_choice(ball_plant(PAIRS))
    assert sorted(choice.input) == list(range(6))
    assert set(choice.name) == {f"rest_length_pair{i}" for i in range(6)}
