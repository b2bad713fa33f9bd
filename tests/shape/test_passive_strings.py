"""Shapes that winches can hold where some strings are passive or share a winch."""

import numpy as np
import pytest

import tenscontrol as tc

LOW = tc.Height(0.9, top=[0, 1, 2], bottom=[3, 4, 5])
CHOICES = (
    [0, 1, 2, 6, 7, 8],
    ["vertical"],
    ["top", "bottom"],
    {"lid": ["top"], "sides": ["vertical"]},
    {"sides": {6: 1.0, 7: 0.5, 8: 2.0}},
    [6, 7],
)


def prism_model():
    return tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))


def prism_at_rest():
    return tc.prestress(tc.prism(), force_density=17.3205)


def values_of(target_or_path, input):
    return getattr(target_or_path, input)


@pytest.mark.parametrize(
    ("actuated", "input"),
    list(zip(CHOICES, 3 * ["rest_length", "force_density"], strict=True)),
    ids=str,
)
def test_a_shape_and_the_path_to_it_are_what_winches_can_hold(actuated, input):
    model, rest = prism_model(), prism_at_rest()
    plant = tc.linearize(model, rest, input, actuated=actuated)
    try:
        target = tc.shape_target(model, LOW, prestress="least", plant=plant)
    except tc.shape.ShapeError as error:
        assert input == "force_density"  # which leaves a prism hardly any shape
        target = error.nearest
    act = plant.actuation
    values = values_of(target, input)
    assert np.allclose(values, act.strings(act.inputs(values)), rtol=0, atol=1e-9)
    assert target.residual < 1e-9
    if target.missed or not target.is_stable:
        return
    try:
        path = tc.shape_path(model, rest, target, duration=1.0, plant=plant)
    except tc.shape.PathError:
        assert input == "force_density"
        return
    for column in values_of(path, input).T:
        assert np.allclose(column, act.strings(act.inputs(column)), rtol=0, atol=1e-9)
    assert path.residual < 1e-9


def test_a_structure_held_at_what_was_found_stays():
    model, rest = prism_model(), prism_at_rest()
    plant = tc.linearize(model, rest, "rest_length", actuated=["vertical"])
    target = tc.shape_target(model, LOW, prestress="least", plant=plant)
    run = tc.simulate(model, 1.0, target.nodes, rest_length=target.rest_length)
    assert np.abs(run.nodes - target.nodes[:, :, None]).max() < 1e-9
    # Without the plant, strings that no winch drives would have to change.
    free = tc.shape_target(model, LOW, force_density=17.3205)
    wound = np.abs(free.rest_length - target.rest_length)[plant.actuation.passive]
    assert wound.max() > 0.01


def test_a_ball_of_which_half_the_strings_are_springs():
    ball = tc.library.six_bar_ball()
    model = tc.Model(ball, strings=tc.LinearStrings(stiffness=500.0))
    rest = tc.prestress(ball, min_force_density=20.0)
    plant = tc.linearize(model, rest, "rest_length", actuated=list(range(12)))
    place = rest.structure.nodes[:, 0] + [0.0, 0.0, 0.05]
    demand = tc.NodesAt([0], place[:, None], tolerance=1e-6)
    target = tc.shape_target(model, demand, prestress="least", plant=plant, place="centre")
    passive = plant.actuation.passive
    assert len(passive) == 12
    assert np.allclose(target.rest_length[passive], plant.actuation.offset[passive], atol=1e-9)
    assert target.is_stable


def test_one_orbit_of_a_symmetric_shape_is_held_once():
    model, rest = prism_model(), prism_at_rest()
    plant = tc.linearize(model, rest, "rest_length", actuated=["vertical"])
    symmetric = tc.RotationalSymmetry([[0, 1, 2], [3, 4, 5]])
    target = tc.shape_target(model, LOW, prestress="least", plant=plant, symmetry=symmetric)
    assert np.allclose(target.rest_length[:6], plant.actuation.offset[:6], atol=1e-9)
    assert np.ptp(target.force_density[6:]) < 1e-9


def test_what_cannot_be_held_is_the_nearest_and_says_by_how_much():
    model, rest = prism_model(), prism_at_rest()
    plant = tc.linearize(model, rest, "rest_length", actuated=[0])
    upright = LOW, tc.shape.PointAt([0, 1, 2], [0.3, 0.0, 0.9])
    with pytest.raises(tc.shape.ShapeError, match=r"misses \d of 10: .* missed by") as caught:
        tc.shape_target(model, upright, prestress="least", plant=plant, place="centre")
    nearest = caught.value.nearest.rest_length
    assert np.allclose(nearest[1:], plant.actuation.offset[1:], atol=1e-9)


def test_bounds_of_winches_are_not_those_of_springs():
    model, rest = prism_model(), prism_at_rest()
    plant = tc.linearize(model, rest, "rest_length", actuated=["vertical"])
    free = tc.shape_target(model, LOW, prestress="least", plant=plant)
    wound = free.rest_length[6]
    assert (free.rest_length[:6] > wound * 1.05).all()  # which the range would refuse
    winches = tc.Winches(shortest=0.5 * wound, longest=1.05 * wound, rate=0.1)
    target = tc.shape_target(model, LOW, prestress="least", plant=plant, winches=winches)
    assert np.allclose(target.rest_length, free.rest_length, atol=1e-6)


def test_ends_and_plants_that_do_not_fit_are_refused():
    model, rest = prism_model(), prism_at_rest()
    plant = tc.linearize(model, rest, "rest_length", actuated=["vertical"])
    free = tc.shape_target(model, LOW, force_density=17.3205)
    with pytest.raises(ValueError, match=r"goal has a rest length .* passive in plant"):
        tc.shape_path(model, rest, free, duration=1.0, plant=plant)
    ganged = tc.linearize(
        model, rest, "rest_length", actuated={"a": [0, 1], **{f"b{k}": [k] for k in range(2, 9)}}
    )
    uneven = tc.shape_target(
        model, tc.NodesAt([0], free.nodes[:, :1] + 0.05, tolerance=1e-6), force_density=17.3205
    )
    with pytest.raises(ValueError, match=r"goal has a rest length .* winch that it shares"):
        tc.shape_path(model, rest, uneven, duration=1.0, plant=ganged)
    with pytest.raises(TypeError, match=r"plant .*linearize\(..., actuated"):
        tc.shape_target(model, LOW, plant=[6, 7, 8])
    other = tc.library.six_bar_ball()
    with pytest.raises(ValueError, match="plant is of"):
        tc.shape_target(tc.Model(other), [], force_density=1.0, plant=plant)
    with pytest.raises(ValueError, match="no string law"):
        tc.shape_target(tc.prism(), LOW, force_density=1.0, plant=plant)


def driven_path(actuated, **settings):
    ball = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
    law = tc.LinearStrings(stiffness=1000.0, damping=10.0)
    ground = tc.Ground(stiffness=5e3, damping=0.5, friction=0.5, slip_speed=0.05)
    model = tc.Model(ball, strings=law, gravity=9.81, ground=ground)
    nodes = tc.plant.set_down(model, [0, 4, 8])
    return tc.shape.tipping_path(
        model, 0.55, [0, 4, 8], [1.0, 0.0, 0.0], nodes=nodes, actuated=actuated, **settings
    )


def test_tipping_winds_what_is_driven():
    path = driven_path(list(range(0, 24, 2)))
    assert np.array_equal(path.rest_length[1::2], np.full_like(path.rest_length[1::2], 0.55))
    assert path.margin[-1] >= 0.02
    pairs = {f"pair_{k}": {2 * k: 1.0, 2 * k + 1: -0.5} for k in range(12)}
    wound = driven_path(pairs).rest_length - 0.55
    assert np.allclose(wound[1::2], -0.5 * wound[::2], rtol=0, atol=1e-12)
    everything = driven_path(None)
    assert np.array_equal(everything.rest_length, driven_path(list(range(24))).rest_length)


def test_limits_of_winches_hold_for_ganged_strings():
    pairs = {f"pair_{k}": {2 * k: 1.0, 2 * k + 1: -0.5} for k in range(12)}
    winches = tc.Winches(rate=0.2, shortest=0.45, longest=0.75)
    wound = driven_path(pairs, winches=winches, margin=0.005).rest_length
    assert wound.min() >= 0.45
    assert wound.max() <= 0.75
    steps = np.abs(np.diff(driven_path(pairs, step=0.005).rest_length)).max()
    assert steps <= 0.005 + 1e-12


def test_too_few_winches_to_tip_are_said():
    with pytest.raises(tc.shape.TippingError, match="the centre of mass comes to"):
        driven_path([3], winches=tc.Winches(shortest=0.5, longest=0.6))


def test_a_ball_rolls_by_half_of_its_strings():
    from tests.benchmarks.rolling import rolled

    gait, runs = rolled(0.0, steps=1, driven=12)
    assert len(gait.made) == 1
    for run in runs:
        assert np.array_equal(run.rest_length[1::2], np.full_like(run.rest_length[1::2], 0.55))
