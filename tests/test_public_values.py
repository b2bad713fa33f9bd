"""Public values do not change, in fields nor arrays, and each says in a line what it is."""

import dataclasses
import inspect
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.short_repr import short_repr
from tests.fuzz.valid_calls import along_rail
from tests.public import public, public_classes
from tests.robustness.cases import loop_case

PACKAGE = Path(tc.__file__).parent
PROJECT = Path(__file__).parent.parent

GROUNDS = (tc.Ground, tc.dynamics.HertzGround, tc.dynamics.SmoothGround)

# ---- values ----


@pytest.fixture(scope="module")
def values(tmp_path_factory):
    """One value of each public dataclass, by class name."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0, damping=0.1))
    rest = tc.prestress(prism, force_density=17.3205)
    plant = tc.linearize(model, rest)
    regulator = tc.LQR(plant, Q=1.0, R=1e-3, sample_time=0.01, max_force_density=50.0)
    mpc = tc.MPC(plant, horizon=3, sample_time=0.01, max_force_density=50.0)
    still = np.zeros((3, 6))
    sensors = tc.Sensors(structure=prism, string_length=0.001, nodes=[0, 2], node_position=0.01)
    held = tc.linearize(model, rest, input="rest_length")
    estimator = tc.KalmanFilter(held, sensors, sample_time=0.01)
    motor = tc.Motor(drum_radius=np.full(9, 0.01), torque=2.0, zero=0.8)
    winches = tc.Winches(rate=0.5, shortest=np.full(9, 0.1), longest=2.0, motor=motor)
    start = tc.to_rest_length(model, prism.nodes, rest.force_density)
    run = tc.simulate(
        model,
        0.02,
        controller=regulator,
        winches=winches,
        rest_length=start.rest_length,
        output_step=0.01,
        estimator=estimator,
    )
    ground = tc.Ground(5e3, friction=0.9)
    standing = tc.Model(prism, strings=model.strings, gravity=9.81, ground=ground)
    stance = tc.equilibrium(standing, rest_length=0.9 * start.rest_length)
    below = tc.Ground(stiffness=5e3, friction=0.5, height=-1e-3)
    dropped = tc.simulate(
        tc.Model(prism, gravity=9.81, ground=below),
        0.02,
        force_density=np.full(9, 20.0),
        step=1e-3,
    )
    moving = tc.simulate(model, 0.02, rest_length=start.rest_length, step=1e-3)
    read_by = tc.Sensors(structure=prism, node_position=1e-3)
    log = tc.Log.of_run(moving, read_by, [0.01, 0.02], seed=0)
    fitted = tc.fit(model, log, ["stiffness"], groups={"stiffness": "all"})
    planned = tc.optimal_motion(**along_rail())
    height = tc.Height(0.9, top=[0, 1, 2], bottom=[3, 4, 5])
    target = tc.shape_target(model, height, force_density=17.3205)
    steel = tc.sizing.materials["steel"]
    stout = tc.sections(prism, bars=steel, strings=steel, bar_radius=0.01, string_radius=np.ones(9))
    found = [
        steel,
        tc.sizing.Tube(0.8),
        stout,
        tc.design(prism, bars=steel, strings=steel, min_force_density=10.0, restarts=1),
        tc.sizing.complexity(
            {1: prism},
            lambda one: tc.design(one, bars=steel, strings=steel, min_force_density=10.0),
        ),
        tc.sensitivity(moving, ["stiffness"]),
        tc.strength(moving, stout),
        model.symbolic("rest_length", ["stiffness"]),
        tc.rigidity(plant, 1e7),
        tc.deflections(model, rest, []),
        tc.stiffness_along(model, rest, []),
        fitted,
        fitted.identifiability,
        fitted.residuals[0],
        log,
        tc.optimize.LogNormal(100.0, 0.5),
        planned,
        planned.meshes[0],
        tc.plot.residuals(fitted.residuals[0]),
        tc.gradient(moving, lambda time, nodes, velocities: nodes[2, 3], ["stiffness"]),
        height,
        tc.Twist(0.1, top=[0, 1, 2], bottom=[3, 4, 5]),
        tc.NodesAt([0], np.zeros((3, 1))),
        tc.shape.PointAt([0, 1], np.zeros(3)),
        tc.RotationalSymmetry([[0, 1, 2], [3, 4, 5]]),
        target,
        target.demands[0],
        tc.shape_path(model, rest, target, duration=1.0, step=0.2),
        tc.shape.tipping_path(
            tc.Model(prism, strings=model.strings, gravity=0.1),
            start.rest_length,
            [3, 4, 5],
            [1.0, 0.0, 0.0],
        ),
        tc.shape.RollingStep(0.0, np.arange(3), np.arange(2), np.arange(3)),
        prism,
        rest,
        stance,
        stance.contacts,
        stance.tipping,
        rest.stability,
        rest.tangent_stiffness(100.0),
        plant,
        plant.coordinates,
        plant.sparse,
        tc.reduce(plant, modes=2),
        tc.modes(plant),
        tc.controllability(plant),
        tc.actuator_choice(plant),
        tc.linearize(model, rest, actuated=[0, 1]).actuation,
        run,
        run.control,
        run.control.estimate,
        estimator.observability(),
        estimator.smooth(run.control.estimate.measurement, run.control.applied),
        dropped.contacts,
        tc.simulate(
            model,
            0.01,
            rest_length=start.rest_length,
            step=0.01,
            error="none",
            bar_length=tc.Profile([0.0, 0.01], np.outer(prism.bar_length, [1.0, 1.01])),
        ).struts,
        sensors,
        estimator.update(None),
        estimator.statistics,
        run.choice,
        run.work,
        tc.integrate.MethodChange(0.1, "cvodes", "it got twice as far"),
        run.health,
        run.health.clearance,
        tc.structure.BarCrossing(0.5, (0, 1)),
        batch := tc.simulate_many(
            tc.Scene(
                model, 0.01, rest_length=start.rest_length, integration=tc.Integration(step=0.01)
            ),
            {"gravity": [0.0, 1.0]},
        ),
        batch.crossings,
        tc.sensitivity(batch, ["nodes"]),
        tc.exciting_input(
            tc.identifiable(model, log, ["stiffness"], step=5e-3),
            tc.Winches(rate=0.1),
            most_rollouts=2,
            parts=1,
        ),
        tc.Stepper(model, 0.01, step=0.01, rest_length=start.rest_length.copy()).state,
        tc.learning.Rolling(np.array([1.0, 0.0, 0.0])),
        tc.learning.Reach(0, np.zeros(3)),
        tc.learning.Track(0, np.zeros_like),
        tc.HealthLimits(),
        tc.Profile([0.0, 1.0], np.ones((9, 2))),
        tc.CutString(string=3, time=1.0),
        tc.StuckWinch(string=5, time=0.8, until=1.5),
        tc.LostMeasurement(time=0.5, until=0.7),
        start,
        motor,
        run.control.motors,
        winches,
        winches.move(start.rest_length, start.rest_length, 0.01),
        model.strings,
        tc.ElasticStrings(axial_rigidity=np.full(9, 100.0)),
        *(grounds := [ground(1e3, nodes=np.arange(3), normal=np.ones(3)) for ground in GROUNDS]),
        tc.Model(prism, ground=grounds).contacts,
        tc.OperatingPoint(prism.nodes.copy(), rest.force_density.copy(), still),
        regulator.command(0.0, prism.nodes, still),
        tc.Reference([0.0], prism.nodes[:, :, None], rest.force_density[:, None]),
        mpc.statistics,
        tc.control.MPCSettings(horizon=3, sample_time=0.01, max_force_density=np.full(9, 50.0)),
        tc.generate_c(regulator, tmp_path_factory.mktemp("code")),
        tc.deploy.MemoryUse(1, 2, ("sqrt",)),
        tc.NMPC(plant, horizon=3, sample_time=0.01, max_force_density=50.0).statistics,
        tc.FeedbackLinearization(
            plant, reference=None, sample_time=0.01, max_force_density=50.0, frequency=1.0
        ).statistics,
        tc.OutputLimit(np.ones((1, 18)), np.zeros(1), np.ones(1)),
        tc.control.held_loop(plant, regulator.gain, sample_time=0.01),
        tc.load_scene(PROJECT / "examples" / "scenes" / "prism_free.toml"),
        tc.exchange.from_mujoco(tc.exchange.to_mujoco(model, rest_length=start.rest_length)),
    ]
    case = tc.Scene(model, 0.05, force_density=rest.force_density)
    compared = tc.work_precision(case, ["rk4"], {"rk4": [0.01]}, repeats=1, outputs=5)
    drift = tc.long_run(case, "rk4", 1e-3, steps=30, outputs=30)
    found += [
        case,
        case.integration,
        compared,
        compared.rows[0],
        compared.reference,
        compared.predictability,
        compared.ratios(against=["rk4"]),
        tc.convergence_order(case, "rk4", [0.01], compared.reference),
        tc.stability_map("rk4", [1e3], [0.1], steps=20),
        drift,
        drift.drifts[0],
    ]
    loop = loop_case(
        prism,
        model.strings,
        regulator,
        0.02,
        0.01,
        1.0,
        nodes=prism.nodes.copy(),
        rest_length=start.rest_length,
        winches=winches,
    )
    drawn = {"bar_mass": tc.Uniform(-2, -1), "damping": tc.Normal(1.0, 0.1)}
    with ThreadPoolExecutor(1) as executor:
        report = tc.sweep(loop, drawn, 4, seed=0, executor=executor)
    found += [*drawn.values(), tc.OneOf([1, 2]), loop, loop({}, np.random.default_rng(0))]
    found += [report, report.failures[0]]
    return {type(value).__name__: value for value in found}


# What integrators, solvers and peers hand to each other holds arrays of their own.
WITHIN_A_RUN = {"Equation", "Method", "QPSolution", "QuadraticProgram", "Solution", "Span"}
DATA = [
    cls.__name__
    for name, cls in public_classes().items()
    if dataclasses.is_dataclass(cls)
    and not name.startswith("plot.")
    and not inspect.isabstract(cls)
    and cls.__name__ not in WITHIN_A_RUN
]


def test_every_dataclass_is_frozen():
    data = [cls for cls in public_classes().values() if dataclasses.is_dataclass(cls)]
    assert [cls.__name__ for cls in data if not cls.__dataclass_params__.frozen] == []


@pytest.mark.parametrize("name", DATA)
def test_fields_cannot_be_set(values, name):
    value = values[name]
    for field in dataclasses.fields(value):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(value, field.name, None)
        with pytest.raises(dataclasses.FrozenInstanceError):
            delattr(value, field.name)


def _held(value):
    """Fields and public attributes that a value holds, rather than computes at each access."""
    fields = {field.name for field in dataclasses.fields(value)}
    for name in dir(value):
        if name in fields or not name.startswith("_"):
            attribute = getattr(value, name)
            if attribute is getattr(value, name) and not inspect.ismethod(attribute):
                yield name, attribute


def _arrays(name, value):
    if isinstance(value, np.ndarray):
        yield name, value
    elif isinstance(value, tuple | list):
        for i, entry in enumerate(value):
            yield from _arrays(f"{name}[{i}]", entry)


@pytest.mark.parametrize("name", DATA)
def test_arrays_cannot_be_written(values, name):
    writable = []
    for attribute, held in _held(values[name]):
        for where, array in _arrays(attribute, held):
            # A read-only view of a writable array is no protection.
            bases = [array]
            while isinstance(bases[-1].base, np.ndarray):
                bases.append(bases[-1].base)
            if any(base.flags.writeable for base in bases):
                writable.append(where)
    assert writable == []


def _given():
    """Constructors with the arrays they are given."""
    prism = tc.prism()
    point = {"nodes": prism.nodes.copy(), "force_density": np.ones(9)}
    return {
        "Structure": {
            "nodes": prism.nodes.copy(),
            "bars": prism.bars.copy(),
            "strings": prism.strings.copy(),
            "bar_mass": np.ones(3),
        },
        "Profile": {"time": np.arange(2.0), "values": np.ones((9, 2))},
        "LinearStrings": {"stiffness": np.ones(9), "damping": np.ones(9)},
        "ElasticStrings": {"axial_rigidity": np.ones(9), "damping": np.ones(9)},
        "Ground": {"stiffness": 1e3, "normal": np.ones(3), "nodes": np.arange(3)},
        "Scene": {
            "model": tc.Model(prism),
            "duration": 1.0,
            "nodes": prism.nodes.copy(),
            "velocities": np.zeros((3, 6)),
            "force_density": np.ones(9),
            "prestress": np.ones(9),
        },
        "OperatingPoint": point | {"external_force": np.ones((3, 6))},
        "Winches": {"rate": np.ones(9), "shortest": np.ones(9), "longest": np.ones(9)},
        "NodesAt": {"nodes": np.arange(2), "positions": np.ones((3, 2))},
        "shape.PointAt": {"nodes": np.arange(2), "position": np.ones(3), "weights": np.ones(2)},
        "OneOf": {"values": np.ones(3)},
        "Sensors": {
            "structure": prism,
            "node_position": np.ones(2),
            "string_length": np.ones(9),
            "bar_direction": np.ones(1),
            "string_tension": np.ones(1),
            "nodes": np.array([1, 4]),
            "strings": np.arange(9),
            "bars": np.array([2]),
            "tension_strings": np.array([3]),
        },
        "Reference": {
            "time": np.arange(2.0),
            "nodes": np.ones((3, 6, 2)),
            "force_density": np.ones((9, 2)),
        },
    }


@pytest.mark.parametrize("name", _given())
def test_arrays_given_are_not_kept(name):
    given = _given()[name]
    value = public()[name](**given)
    arrays = {name: array for name, array in given.items() if isinstance(array, np.ndarray)}
    assert arrays
    before = {argument: getattr(value, argument).copy() for argument in arrays}
    for array in arrays.values():
        array[...] = 99
    for argument, array in before.items():
        np.testing.assert_array_equal(getattr(value, argument), array)


# ---- shown in a line ----

LONGEST = 500


def test_no_class_shows_an_address():
    shown = [name for name, cls in public_classes().items() if cls.__repr__ is object.__repr__]
    assert shown == []


def test_values_are_shown_in_a_line(values):
    found = {name: repr(value) for name, value in values.items()}
    assert {name: text for name, text in found.items() if " at 0x" in text} == {}
    assert {name: len(text) for name, text in found.items() if len(text) > LONGEST} == {}
    assert [name for name, text in found.items() if "\n" in text] == []


def test_a_controlled_run_and_a_gait_are_shown_in_a_line():
    model = tc.Model(tc.prism(), strings=tc.LinearStrings(stiffness=100.0))
    plant = tc.linearize(model, tc.prestress(model.structure, force_density=10.0), "rest_length")
    law = tc.LQR(plant, sample_time=0.01)
    run = tc.simulate(model, 0.1, controller=law, rest_length=plant.rest_length, step=5e-3)
    assert repr(run.control) == f"ControlRecord({law!r}, 10 samples: 10 ok)"


@pytest.mark.parametrize(
    ("law", "text"),
    [
        (tc.LinearStrings(np.full(24, 100.0)), "LinearStrings(stiffness=100, damping=0)"),
        (tc.LinearStrings(100.0), "LinearStrings(stiffness=100, damping=0)"),
        (tc.Uniform(0, 1), "Uniform(size=None, low=0.0, high=1.0)"),
    ],
)
def test_equal_entries_are_written_once(law, text):
    assert repr(law) == text


def test_arrays_are_shown_by_shape_and_range():
    reference = tc.Reference([0.0, 1.0], np.zeros((3, 6, 2)) + np.array([0.0, 2.0]))
    assert short_repr(reference) == "Reference(time=[0, 1], nodes=3×6×2 from 0 to 2)"
