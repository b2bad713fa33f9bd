"""Large scenes: operations on all members, and loops in C, give what the flat expression gives."""

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.evaluator import Evaluator
from tenscontrol.dynamics.forces import Forces
from tenscontrol.dynamics.forms.loops import loops_source
from tenscontrol.dynamics.machine_code import compiler
from tenscontrol.dynamics.model import LARGEST_FLAT
from tests.dynamics.scenes import any_motion, random_structure, side_by_side

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")
FORMS = ["mapped", pytest.param("loops", marks=needs_compiler)]


@pytest.fixture(autouse=True, scope="module")
def own_cache(tmp_path_factory):
    """Libraries are made anew and not left behind."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


def swinging():
    """A prism on three hinges, with a fixed bar and a fixed string node beside it."""
    prism = tc.prism()
    beside = [[1.0, 1.0, 2.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.5]]
    return tc.Structure(
        np.hstack([prism.nodes, beside]),
        [*prism.bars.tolist(), [6, 7]],
        [*prism.strings[[0, 1, 2, 6, 7, 8]].tolist(), [0, 7], [8, 1], [6, 8]],
        [1.0, 2.0, 3.0, 4.0],
        fixed=[3, 4, 5, 6, 7, 8],
    )


def chain():
    return tc.Structure(
        np.array([[0.0, 1.0, 2.0, 3.0], [0.0, 0.1, 0.0, 0.2], [0.0, 0.0, 0.3, 0.0]]),
        [],
        [[0, 1], [1, 2], [2, 3]],
        [],
        string_node_mass=[0.1, 0.2, 0.4],
        fixed=[0],
    )


STRUCTURES = {
    "prism": tc.prism,
    "tower": lambda: tc.prism_tower(3, bar_mass=np.arange(1.0, 10.0)),
    "subdivided": lambda: tc.subdivide(tc.prism(), 3, node_mass=0.01),
    "skin": lambda: tc.skin(tc.prism(), ("top", "bottom"), iterations=2, node_mass=0.01),
    "net": lambda: tc.net(4, 3, 0.1, 0.01),
    "swinging": swinging,
    "chain": chain,
    "bars only": lambda: tc.Structure(np.eye(3, 4), [[0, 1], [2, 3]], [], [1.0, 2.0]),
    "any order": lambda: random_structure(7, bars=4, points=3),
}


def laws(count):
    """String laws with shared and with differing parameters."""
    random = np.random.default_rng(count)
    differing, damping = random.uniform(50.0, 150.0, count), random.uniform(0.0, 2.0, count)
    damping[::2] = 0.0
    return {
        "linear": tc.LinearStrings(100.0),
        "linear, differing": tc.LinearStrings(differing),
        "linear, damped": tc.LinearStrings(100.0, 1.0),
        "linear, some damped": tc.LinearStrings(differing, damping),
        "elastic": tc.ElasticStrings(differing),
        "elastic, damped": tc.ElasticStrings(100.0, 0.5),
    }


LAWS = [*laws(2), None]


def scene(name, law, **options):
    structure = STRUCTURES[name]()
    strings = len(structure.strings)
    law = laws(strings)[law] if law and strings else None
    model = tc.Model(structure, law, **options)
    random = np.random.default_rng(3)
    x = pack_state(structure, *any_motion(structure, 5))
    u = random.uniform(0.3, 1.5, strings)
    taut = random.integers(0, 2, strings if law else 0).astype(float)
    return model, "rest_length" if law else "force_density", (x, u, taut)


def evaluated(equation, x, u, taut):
    """Copies of slope, gap, its rate, and force."""
    half = len(x) // 2
    results = [
        Evaluator(equation.slope)(x, u, taut),
        Evaluator(equation.gap)(x, u),
        Evaluator(equation.force)(x[:half], x[half:], u, taut),
    ]
    return [array.copy() for group in results for array in group]


def assert_same(found, expected):
    for one, other in zip(found, expected, strict=True):
        assert one.shape == other.shape
        scale = np.abs(other).max(initial=1.0)
        np.testing.assert_allclose(one, other, rtol=0, atol=2e-14 * scale)


@pytest.mark.parametrize(
    ("name", "law"),
    [
        (name, law)
        for i, name in enumerate(STRUCTURES)
        for j, law in enumerate(LAWS)
        if (i + j) % 5 == 0 or name == "swinging"
    ],
)
def test_all_forms_agree(name, law):
    model, held, at = scene(name, law)
    flat = model.equation(held, form="flat")
    expected = evaluated(flat, *at)
    for form in ("mapped", "loops") if compiler() else ("mapped",):
        other = model.equation(held, form=form)
        assert other.form == form
        assert other.velocity_dependent == flat.velocity_dependent
        sizes = [(each.states, each.inputs, each.switches) for each in (flat, other)]
        assert sizes[0] == sizes[1]
        assert_same(evaluated(other, *at), expected)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["tower", "net", "swinging"])
def test_weights_and_loads_act_in_all_forms(name, form):
    model, held, at = scene(name, "linear", gravity=9.81, external_force=True)
    load = np.random.default_rng(1).normal(size=model.structure.nodes.shape)
    bare = evaluated(model.equation(held, form="flat"), *at)
    flat = evaluated(model.equation(held, load, form="flat"), *at)
    assert np.abs(flat[0] - bare[0]).max() > 0.1
    assert_same(evaluated(model.equation(held, load, form=form), *at), flat)
    assert_same(evaluated(model.equation(held, form=form), *at), bare)


@pytest.mark.parametrize("form", FORMS)
def test_the_state_equation_of_the_model_is_the_kinked_slope_of_each_form(form):
    model, held, (x, u, _) = scene("tower", "linear, some damped")
    expected = np.array(model.rest_length_dynamics(x, u)).ravel()
    found = np.array(model.equation(held, form=form).kinked_slope(x, u)).ravel()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("form", FORMS)
def test_a_slack_string_without_length_is_no_harm(form):
    model, held, (x, u, taut) = scene("prism", "linear, damped")
    start, end = model.structure.strings[4]
    x[3 * end : 3 * end + 3] = x[3 * start : 3 * start + 3]
    taut[4] = 0.0
    slope = Evaluator(model.equation(held, form=form).slope)(x, u, taut)[0]
    assert np.isfinite(slope).all()


@pytest.mark.parametrize("form", FORMS)
def test_steps_accumulate_in_a_graph(form):
    model, held, (x, u, taut) = scene("tower", "linear")

    def steps(equation):
        symbols = [equation.symbol("s", size) for size in (len(x), len(u), len(taut))]
        step = ca.Function("step", symbols, [symbols[0] + 1e-4 * equation.slope(*symbols)])
        return np.array(step.mapaccum(20)(x, *(ca.repmat(part, 1, 20) for part in (u, taut))))

    flat, other = (steps(model.equation(held, form=each)) for each in ("flat", form))
    np.testing.assert_allclose(other, flat, rtol=0, atol=1e-12)


def test_mapped_functions_have_derivatives():
    model, held, at = scene("tower", "linear, some damped")
    jacobians = [
        np.array(model.equation(held, form=form).slope.jacobian()(*at, 0)[0].full())
        for form in ("flat", "mapped")
    ]
    scale = np.abs(jacobians[0]).max()
    np.testing.assert_allclose(*jacobians, rtol=0, atol=1e-13 * scale)


# ---- what is chosen ----


def test_a_small_scene_is_flat(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    prism = tc.prism()
    assert len(prism.bars) + len(prism.strings) <= LARGEST_FLAT
    assert tc.Model(prism).equation("force_density").form == "flat"


@needs_compiler
def test_a_large_scene_is_compiled_where_that_is_possible():
    assert tc.Model(tc.prism_tower(3)).equation("force_density").form == "loops"


def test_a_large_scene_goes_without_a_compiler_where_there_is_none(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    model = tc.Model(tc.prism_tower(3))
    assert model.equation("force_density").form == "mapped"
    with pytest.raises(FileNotFoundError, match="no C compiler"):
        model.equation("force_density", form="loops")


def test_unknown_forms_are_refused(prism):
    with pytest.raises(ValueError, match="form is 'fast', expected one of 'auto', 'flat'"):
        tc.Model(prism).equation("force_density", form="fast")


# ---- what a large scene costs ----


@pytest.mark.parametrize("law", [None, "linear"])
def test_the_graph_of_a_mapped_equation_does_not_grow(prism, law):
    strings = law and tc.LinearStrings(100.0)
    held = "rest_length" if law else "force_density"
    counts = {
        tc.Model(side_by_side(prism, copies), strings)
        .equation(held, form="mapped")
        .slope.n_instructions()
        for copies in (1, 2, 8)
    }
    assert len(counts) == 1


def test_only_the_tables_of_the_loops_grow(prism):
    def code(copies):
        structure = side_by_side(prism, copies)
        law = tc.LinearStrings(100.0).for_count(len(structure.strings))
        source = loops_source(Forces(structure, law), np.zeros_like(structure.nodes))
        tables = [part.split("};")[0] for part in source.split("{\n")[1:] if "," in part[:4]]
        return sum(map(len, tables)), len(source) - sum(map(len, tables))

    (small, text), (large, same) = code(1), code(50)
    assert large > 40 * small
    assert same - text < 100  # digits of the sizes


def test_shared_parameters_take_no_table():
    model, *_ = scene("tower", "linear")
    shared = tc.prism_tower(3)
    law, load = model.strings, np.zeros((3, 18))
    assert "constant" not in loops_source(Forces(shared, law), load)
    assert "constant" in loops_source(Forces(model.structure, law), load)
    assert "load" not in loops_source(Forces(shared, law), load)
    assert "places" not in loops_source(Forces(shared, law), load)
