"""A chain of beads swings as the closed form says, and as a string without mass where it has none.

A chain of s segments with γ each and s - 1 beads of mass m, its ends held, has the frequencies
``ω_k = 2 √(γ/m) sin(kπ/2s)``: across, and with γ held along the chain as well.
"""

import numpy as np
import pytest

import tenscontrol as tc
from tests.dynamics.scenes import TOP_FORCE_DENSITY, paper_force_density, rest_lengths

SEGMENTS = (2, 3, 5, 8, 13, 21, 32)
BEAD = 0.01


def between_supports(segments, bead=BEAD):
    """A chain between two fixed nodes, 2 m long under 10 N; its model, rest and tension."""
    whole = tc.Structure([[0, 2], [0, 0], [0, 0]], [], [[0, 1]], [], fixed=[0, 1])
    chain = tc.subdivide(whole, segments, node_mass=bead)
    gamma = tc.structure.spread_force_density(chain, 5.0)
    model = tc.Model(chain, strings=tc.LinearStrings(40.0 * segments))
    return model, tc.prestress(chain, gamma), 10.0


def between_bars(segments, bead=BEAD, bar=1e8):
    """A prism at rest, γ_v = 30 N/m, with beads on one of its vertical strings."""
    prism = tc.prism(bar_mass=bar)
    whole = tc.prestress(prism, TOP_FORCE_DENSITY)
    chain = tc.subdivide(prism, [1] * 8 + [segments], node_mass=bead)
    gamma = tc.structure.spread_force_density(chain, whole.force_density)
    tension = whole.force_density[8] * prism.string_length()[8]
    return tc.Model(chain), tc.prestress(chain, gamma), tension


def beads_of(model, rest, held="force_density"):
    """Angular frequencies of the beads: the highest, far above those of heavy bars."""
    found = tc.modes(tc.linearize(model, rest, held, "minimal"))
    count = 3 * len(model.structure.string_nodes)
    return 2 * np.pi * found.frequency[-count:], found.shape[:, :, -count:]


def closed_form(stiffness, segments, bead=BEAD):
    k = np.arange(1, segments)
    return 2 * np.sqrt(stiffness / bead) * np.sin(k * np.pi / (2 * segments))


# ---- closed form ----


@pytest.mark.parametrize("segments", SEGMENTS)
def test_frequencies_between_fixed_nodes(segments):
    model, rest, _ = between_supports(segments)
    expected = np.repeat(closed_form(5.0 * segments, segments), 3)
    np.testing.assert_allclose(beads_of(model, rest)[0], expected, rtol=1e-12)


@pytest.mark.parametrize("segments", SEGMENTS)
def test_frequencies_between_heavy_bars(segments):
    """Bars of 1000 t: measured 1e-8 (2 segments) to 2.6e-7 (32)."""
    model, rest, _ = between_bars(segments, bar=1e6)
    expected = np.repeat(closed_form(30.0 * segments, segments), 3)
    np.testing.assert_allclose(beads_of(model, rest)[0], expected, rtol=4e-7)


@pytest.mark.parametrize(("segments", "error"), [(2, 1.0e-4), (8, 6.3e-4), (32, 2.6e-3)])
def test_bars_hold_the_better_the_heavier_they_are(segments, error):
    """The error is of order one in bead over bar."""
    masses, errors = np.array([1e2, 1e3, 1e4, 1e5]), []
    expected = np.repeat(closed_form(30.0 * segments, segments), 3)
    for mass in masses:
        model, rest, _ = between_bars(segments, bar=mass)
        errors.append(np.abs(beads_of(model, rest)[0] / expected - 1).max())
    assert errors[0] == pytest.approx(error, rel=0.05)
    assert np.polyfit(np.log(masses), np.log(errors), 1)[0] == pytest.approx(-1.0, abs=0.005)


@pytest.mark.parametrize("segments", [2, 5, 8, 32])
def test_with_rest_length_held_the_stiffness_counts_along_the_chain(segments):
    """Across, γ holds the beads as before, twice; along the chain it is k."""
    model, rest, _ = between_supports(segments)
    frequency, shape = beads_of(model, rest, "rest_length")
    across = np.repeat(closed_form(5.0 * segments, segments), 2)
    along = closed_form(40.0 * segments, segments)
    size = np.linalg.norm(shape, axis=1)  # of x, y and z, mode by mode
    is_along = size[0] > 0.5 * np.linalg.norm(size, axis=0)
    np.testing.assert_allclose(frequency[~is_along], across, rtol=1e-12)
    np.testing.assert_allclose(frequency[is_along], along, rtol=1e-12)
    assert size[0, ~is_along].max() < 1e-10
    assert size[1:, is_along].max() < 1e-10


def test_the_shapes_are_sines():
    segments = 8
    model, rest, _ = between_supports(segments)
    _, shape = beads_of(model, rest)
    j = np.arange(1, segments)
    for i, displacement in enumerate(np.moveaxis(shape[:, 2:], 2, 0)):
        sine = np.sin((i // 3 + 1) * np.pi * j / segments)
        off = displacement - np.outer(displacement @ sine, sine) / (sine @ sine)
        assert np.abs(off).max() < 1e-10


# ---- the vibrating string ----


@pytest.mark.parametrize("support", [between_supports, between_bars])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_beads_of_a_segment_each_approach_the_vibrating_string_with_order_two(support, n):
    """Beads of m/s leave the two outer half segments to the supports: order two.

    The whole mass m on s - 1 beads would have order one; see ``subdivide`` and its tests.
    """
    mass = 0.3
    segments, errors = np.array([8, 16, 32]), []
    for s in segments.tolist():
        model, rest, tension = support(s, mass / s)
        ends = model.structure.parent
        length = ends.string_length()[-1]
        exact = n / (2 * length) * np.sqrt(tension / (mass / length))
        hertz = beads_of(model, rest)[0][3 * (n - 1)] / (2 * np.pi)
        errors.append(abs(hertz / exact - 1))
    # sin(x)/x = 1 - x²/6 + x⁴/120 …, x = nπ/2s
    order = -np.polyfit(np.log(segments), np.log(errors), 1)[0]
    assert order == pytest.approx(2.0, abs=0.0015 * n**2)
    assert errors[-1] == pytest.approx((n * np.pi / 64) ** 2 / 6, rel=2e-3)


# ---- no mass at all ----


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
@pytest.mark.parametrize("segments", [2, 4])
def test_vanishing_point_masses_return_the_motion_without_them(held, segments):
    """Error at the bars over 0.1 s: of order one in the point mass.

    The beads add their inertia, and start at rest while the ends of their string accelerate: they
    lag, and shake about their place on the straight string with a frequency of order 1/√m and an
    amplitude of acceleration over frequency squared, order m. Both pull on the bars in that
    order. With γ_v = 45 N/m no string goes slack, so that no switch disturbs the fit; the time is
    short because the steps are as short as the beads are quick.
    """
    prism, gamma = tc.prism(), paper_force_density(45.0)
    options = {"duration": 0.1, "tolerance": 1e-12, "output_step": 0.005}

    def motion(structure):
        count = 1 if structure is prism else segments
        spread = np.repeat(count * gamma, count)
        model = tc.Model(structure, strings=tc.LinearStrings(100.0 * count))
        value = spread if held == "force_density" else rest_lengths(structure, spread, 100 * count)
        run = tc.simulate(model, **options, **{held: value})
        assert run.force_density.min() > 17.0 * count
        return run.nodes

    exact = motion(prism)
    assert np.ptp(exact, axis=2).max() > 0.08
    masses, errors, lags = np.array([1e-3, 1e-4, 1e-5]), [], []
    for mass in masses:
        cut = tc.subdivide(prism, segments, node_mass=mass)
        nodes = motion(cut)
        errors.append(np.abs(nodes[:, :6] - exact).max())
        # Node 6 on string 0, beside the first segment.
        ends = nodes[:, prism.strings[0]]
        straight = ((segments - 1) * ends[:, 0] + ends[:, 1]) / segments
        lags.append(np.abs(nodes[:, 6] - straight).max())
    for each in (errors, lags):
        assert np.polyfit(np.log(masses), np.log(each), 1)[0] == pytest.approx(1.0, abs=0.02)
