"""The settings that MPC and NMPC share: declared once, frozen, and prepared once for a plant."""

import sys
from dataclasses import FrozenInstanceError, fields, replace
from inspect import signature

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import MPCSettings, QPSolution, QPSolver, Status
from tenscontrol.control.mpc.osqp_solver import OSQPSolver
from tenscontrol.docstrings import documented
from tenscontrol.dynamics.evaluator import Function
from tests.deploy import scenes

GIVEN = {"horizon": 4, "sample_time": scenes.SAMPLE, "max_force_density": 80.0}


@pytest.mark.parametrize("kind", [tc.MPC, tc.NMPC])
def test_a_constructor_takes_and_documents_the_fields_of_the_record(kind):
    names = [field.name for field in fields(MPCSettings)]
    parameters = signature(kind).parameters
    assert list(parameters)[: len(names) + 1] == ["plant", *names]
    assert parameters["tolerance"].default == 1e-4
    assert set(parameters) == set(documented(kind))
    assert documented(kind)["time_limit"] == documented(MPCSettings)["time_limit"]


@pytest.mark.parametrize("kind", [tc.MPC, tc.NMPC])
def test_a_controller_keeps_its_settings(kind):
    plant = scenes.plant("force_density")
    limit = np.full(9, 80.0)
    settings = kind(plant, **(GIVEN | {"max_force_density": limit})).law.settings
    limit[0] = 0.0
    assert settings.max_force_density[0] == 80.0
    with pytest.raises(ValueError, match="read-only"):
        settings.max_force_density[0] = 1.0
    with pytest.raises(FrozenInstanceError):
        settings.horizon = 5
    again = kind(plant, **vars(settings)).law.settings
    assert again.longest_time == settings.longest_time == np.inf
    assert again.string_penalty == settings.string_penalty == 100.0


@pytest.mark.parametrize(
    ("solver", "error", "message"),
    [
        (
            "simplex",
            ValueError,
            "solver is 'simplex', expected one of 'auto', 'stages', 'osqp'",
        ),
        (dict, TypeError, "solver is <class 'dict'>, expected a name or a subclass of QPSolver"),
    ],
)
def test_unknown_solvers_are_refused(solver, error, message):
    with pytest.raises(error, match=message):
        MPCSettings(**GIVEN, solver=solver)


class ActiveSet(QPSolver):
    """A solver of one's own: SciPy's SLSQP."""

    def __init__(self, P, A, tolerance, max_iterations, *, equations=False):
        self._P, self._A = P, A.copy()

    def update(self, A):
        self._A.data = A.copy()

    def solve(self, q, l, u, start=None, deadline=np.inf):  # noqa: E741
        from scipy.optimize import LinearConstraint, minimize

        A, equal = self._A.toarray(), l == u
        rows = [LinearConstraint(A[each], l[each], u[each]) for each in (equal, ~equal)]
        answer = minimize(
            lambda x: 0.5 * x @ (self._P @ x) + q @ x, np.zeros(len(q)),
            jac=lambda x: self._P @ x + q, constraints=rows if equal.any() else rows[1:],
            method="SLSQP", options={"ftol": 1e-12, "maxiter": 500},
        )  # fmt: skip
        status = Status.OK if answer.success else Status.UNSOLVED
        return QPSolution(status, answer.x, np.zeros(len(l)), answer.nit)

    def reset(self):
        """It remembers nothing."""


@pytest.mark.parametrize("kind", [tc.MPC, tc.NMPC])
def test_another_solver_is_one_class(kind):
    plant = scenes.plant("force_density")
    nodes = plant.to_nodes(np.full(9, 0.01))
    values = [
        kind(plant, **(GIVEN | {"horizon": 2}), solver=solver, tolerance=1e-8)
        .command(0.0, nodes, np.zeros((3, 6)))
        .value
        for solver in (OSQPSolver, ActiveSet)
    ]
    np.testing.assert_allclose(values[1], values[0], atol=1e-3)


@pytest.mark.parametrize("held", ["force_density", "rest_length"])
@pytest.mark.parametrize("kind", [tc.MPC, tc.NMPC])
def test_a_second_controller_on_a_plant_builds_no_expression(kind, held, monkeypatch):
    plant = replace(scenes.plant(held))  # with nothing prepared
    given = GIVEN | {"max_force_density": 80.0 if held == "force_density" else None}
    limit = tc.clearance(plant, clearance=0.1, penalty=1e4)
    given |= {"max_tension": 300.0, "outputs": [limit], "load_gain": 0.2}
    names, values, built = [], [], []

    def noted(self, name, *given):
        built.append(name)
        ca.Function.__init__(self, name, *given)

    monkeypatch.setattr(Function, "__init__", noted)
    for _ in range(2):
        built.clear()
        made = kind(plant, **given)
        names.append(built.copy())
        values.append(made.command(0.0, plant.to_nodes(np.full(9, 0.003)), np.zeros((3, 6))).value)
    assert "strings" in names[0]
    assert names[1] == []
    np.testing.assert_array_equal(*values)


@pytest.mark.parametrize("cut", [False, True])
def test_held_lengths_are_found_once_for_a_plant(cut, monkeypatch):
    structure = tc.prism()
    gamma = tc.statics.prism_force_density(3, 17.3205)[0]
    if cut:
        structure = tc.subdivide(structure, segments=2, node_mass=0.01)
        gamma = tc.structure.spread_force_density(structure, gamma)
    model = tc.Model(structure, strings=tc.LinearStrings(stiffness=100.0))
    plant = tc.linearize(model, tc.prestress(structure, gamma))
    if cut:
        plant = tc.plant.command_parents(plant)
    built, module = [], sys.modules["tenscontrol.control.held_loop"]
    for name in ("linearize", "string_map"):
        made = getattr(module, name)
        monkeypatch.setattr(
            module, name, lambda *given, made=made, **kw: built.append(1) or made(*given, **kw)
        )
    for _ in range(2):
        if cut:  # no string reaches the middle of a cut one across it
            tc.control.held_loop(plant, np.zeros(plant.B.T.shape), sample_time=0.02)
        else:
            tc.MPC(plant, **GIVEN)
    assert len(built) == 1 + cut


@pytest.mark.parametrize("law", [tc.MPC, tc.NMPC])
def test_wrong_arguments_are_named_with_the_controller(law):
    name = law.__name__
    with pytest.raises(TypeError, match=rf"^{name} needs horizon and sample_time: {name}\("):
        law(None)
    with pytest.raises(TypeError, match=rf"^{name} has no argument 'horizn'; did you mean 'hori"):
        law(None, horizn=5, sample_time=0.1)
    with pytest.raises(TypeError, match=rf"^{name} has no argument 'x'; expected horizon, sample_"):
        law(None, x=5, horizon=3, sample_time=0.1)
