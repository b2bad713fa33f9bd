"""A valid call of each public function, class and method: what the fuzzer spoils.

``CALLS`` has them by name. A name with a comma is a second way to call what stands before it. The
structures are small, so that a call is cheap; a call that is not has a smaller ``share``.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from inspect import signature
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import tenscontrol as tc
from tenscontrol.integrate.methods import METHODS
from tests.control.test_control_input import linearizing, mpc, nmpc, short_path
from tests.public import members, public
from tests.refused import (
    STILL,
    elastic,
    equation,
    estimator,
    gamma,
    held_plant,
    lengths,
    loaded,
    model,
    nodes,
    plant,
    prism,
    regulator,
    rest,
    rest_length,
    winch_regulator,
)
from tests.robustness.cases import Inline, noisy

SCENE = Path(__file__).parents[2] / "examples" / "scenes" / "prism_free.toml"
TOP, BOTTOM = [0, 1, 2], [3, 4, 5]


@dataclass(frozen=True)
class Call:
    """What is called, the arguments that it takes, and what must hold after it.

    ``share`` is how many calls it gets of those that a cheap one gets. ``after`` returns a value
    that must be finite whatever was asked before.
    """

    name: str
    target: Callable[[], Callable]
    arguments: Callable[[], dict]
    share: float = 1.0
    after: Callable | None = None


CALLS: dict[str, Call] = {}


def call(name, arguments=dict, on=None, share=1.0, after=None):
    """Enter a call: of a function or class by its name, or of a method of what ``on`` returns."""
    plain = name.split(",")[0]

    def target():
        return public()[plain] if on is None else getattr(on(), plain.rsplit(".", 1)[1])

    assert name not in CALLS
    CALLS[name] = Call(name, target, arguments, share, after)


# ---- results that are not made by calling their class ----

# Made and returned by functions, or raised: their constructor is no interface. Their methods are.
RESULTS = {
    "accuracy.ConvergedMotion",
    "accuracy.ConvergenceOrder",
    "accuracy.Drift",
    "accuracy.LongRun",
    "accuracy.Measurement",
    "accuracy.Predictability",
    "accuracy.Ratios",
    "accuracy.Solution",
    "accuracy.StabilityMap",
    "accuracy.WorkPrecision",
    "actuation.Actuation",
    "actuation.RestLengths",
    "actuation.MotorRecord",
    "actuation.WinchMove",
    "control.Command",
    "control.FeedbackLinearizationStatistics",
    "control.HeldLoop",
    "control.MPCStatistics",
    "control.NMPCStatistics",
    "control.QuadraticProgram",
    "control.QPSolution",
    "deploy.CompiledController",
    "deploy.CompiledGait",
    "deploy.GeneratedController",
    "deploy.MemoryUse",
    "dynamics.Contacts",
    "dynamics.Coordinates",
    "dynamics.SymbolicModel",
    "dynamics.Equation",
    "estimation.Estimate",
    "estimation.FilterStatistics",
    "estimation.Observability",
    "estimation.SmoothedMotion",
    "exchange.Imported",
    "integrate.Choice",
    "integrate.IntegrationError",
    "integrate.IntegrationInterrupt",
    "integrate.IntegrationPause",
    "integrate.MethodChange",
    "integrate.Projector",
    "interrupt.InterruptionWarning",
    "integrate.Span",
    "integrate.Watched",
    "integrate.Work",
    "optimize.ExcitingInput",
    "optimize.Fit",
    "optimize.Gradient",
    "optimize.Identifiability",
    "optimize.Mesh",
    "optimize.OptimalMotion",
    "optimize.OptimalMotionWarning",
    "optimize.BatchSensitivity",
    "optimize.Sensitivity",
    "optimize.Validation",
    "plant.ActuatorChoice",
    "plant.Controllability",
    "plant.LinearPlant",
    "plant.Modes",
    "plant.ReducedPlant",
    "plant.Deflections",
    "plant.DirectionalStiffness",
    "plant.Rigidity",
    "plant.RigidityWarning",
    "plant.SparsePlant",
    "plant.Stance",
    "plant.StanceContacts",
    "plant.Tipping",
    "plot.Curves",
    "plot.Drawing",
    "plot.FitDrawing",
    "plot.MassDrawing",
    "plot.ModeShape",
    "plot.PoleMap",
    "plot.SweepDrawing",
    "plot.View",
    "robustness.SweepError",
    "robustness.SweepFailure",
    "robustness.SweepReport",
    "scene.SceneError",
    "shape.DemandCheck",
    "simulation.Strength",
    "shape.PathError",
    "shape.RollingStep",
    "shape.ShapeError",
    "shape.ShapePath",
    "shape.ShapeTarget",
    "shape.TippingError",
    "shape.TippingPath",
    "control.ControlWarning",
    "simulation.AccuracyWarning",
    "simulation.BarCrossingWarning",
    "simulation.StrengthWarning",
    "simulation.Batch",
    "simulation.BatchCrossings",
    "simulation.ContactRecord",
    "simulation.ControlRecord",
    "simulation.EstimateRecord",
    "simulation.Arguments",
    "simulation.Health",
    "simulation.SimulationError",
    "simulation.StepperState",
    "simulation.StrutRecord",
    "simulation.Trajectory",
    "sizing.Complexity",
    "sizing.Design",
    "sizing.Sections",
    "statics.Prestress",
    "statics.Stability",
    "statics.TangentStiffness",
    "structure.BarClearance",
    "structure.BarCrossing",
}

# Bases of a user's own classes and enumerations: nobody makes one of them.
ABSTRACT = {
    "accuracy.Peer",
    "control.BaseController",
    "control.Fallback",
    "control.QPSolver",
    "control.Status",
    "dynamics.ContactLaw",
    "dynamics.StringLaw",
    "integrate.Integrator",
    "learning.Task",
    "robustness.Distribution",
    "shape.Demand",
    "simulation.Fault",
}

# Methods of symbols, of a base class, or of a solver that is handed what was checked before.
WITHIN = {
    "simulation.Trajectory.health_of",
    "ClosedLoopCase.alone",
    "ClosedLoopCase.together",
    "Scene.integrated",
    "Scene.plant_run",
    *(f"learning.Task.{name}" for name in ("check", "seen", "reward", "is_reached")),
    *(f"learning.Reach.{name}" for name in ("check", "seen", "reward", "is_reached")),
    *(f"learning.{task}.{name}" for task in ("Rolling", "Track") for name in ("check", "reward")),
    "learning.Track.seen",
    "Model.of_parameters",
    "Model.shared_function",
    "Model.sharing",
    "plot.View.open",
    "plant.Deflections.force_table",
    "plant.Deflections.table",
    "plant.DirectionalStiffness.table",
    "plant.Rigidity.table",
    "optimize.ExcitingInput.table",
    "optimize.Fit.table",
    "optimize.Identifiability.table",
    "optimize.OptimalMotion.summary",
    "optimize.OptimalMotion.table",
    "optimize.Sensitivity.table",
    "simulation.Strength.table",
    "sizing.Complexity.table",
    "sizing.Design.table",
    "sizing.Tube.stress",
    *(f"integrate.RK4.{name}" for name in ("smooth_step", "steps_between", "work_of")),
    "ElasticStrings.tension",
    "ElasticStrings.taut_rest_length",
    "ElasticStrings.stored_energy",
    "LinearStrings.tension",
    "LinearStrings.taut_rest_length",
    "LinearStrings.stored_energy",
    "dynamics.StringLaw.tension",
    "dynamics.StringLaw.taut_rest_length",
    "dynamics.StringLaw.stored_energy",
    "dynamics.StringLaw.symbolic_force_density",
    "dynamics.StringLaw.taut_force_density",
    "dynamics.StringLaw.gap",
    "dynamics.StringLaw.as_expressions",
    "dynamics.StringLaw.with_parameters",
    "Ground.normal_force",
    "dynamics.HertzGround.normal_force",
    "dynamics.SmoothGround.normal_force",
    "dynamics.SmoothGround.gap",
    "dynamics.ContactLaw.normal_force",
    "dynamics.ContactLaw.gap",
    "dynamics.ContactLaw.stored_energy",
    "dynamics.ContactLaw.sinking",
    "dynamics.ContactLaw.force",
    "dynamics.ContactLaw.mean_force",
    "dynamics.ContactLaw.resultant",
    "dynamics.ContactLaw.up",
    *(
        f"dynamics.Contacts.{name}"
        for name in ("of_argument", "passes", "gap_passes", "on_nodes", "mean_force")
    ),
    "dynamics.Contacts.stored_energy",
    "Model.forces",
    "dynamics.Equation.gap_scale",
    "dynamics.Equation.symbols",
    "dynamics.Equation.ahead",
    "dynamics.Equation.of_strings",
    "LQR.reference_nodes",
    "control.LinearController.reset",
    "control.LinearController.reference_nodes",
    "MPC.reference_nodes",
    "NMPC.reference_nodes",
    "FeedbackLinearization.reference_nodes",
    "control.BaseController.reference_nodes",
    "control.BaseController.begin",
    "FunctionController.begin",
    "control.Controller.fall_back",
    "control.Controller.reset",
    "plant.LinearPlant.refuse_long_sample_time",
    "dynamics.Coordinates.laid_over",
    "dynamics.Coordinates.state_of",
    "dynamics.Coordinates.displaced",
    "dynamics.Coordinates.kept_lengths",
    "dynamics.Coordinates.hidden",
    "dynamics.Coordinates.displacements",
    "dynamics.Coordinates.from_sparse",
    "dynamics.Coordinates.to_sparse",
    "dynamics.Coordinates.within",
    "Height.miss",
    "NodesAt.miss",
    "shape.PointAt.miss",
    "Twist.miss",
    "shape.Demand.miss",
    "accuracy.Peer.own_law",
    "accuracy.Peer.refuse",
    "accuracy.Peer.prepare",
    "accuracy.peers.MuJoCo.own_law",
    "accuracy.peers.MuJoCo.refuse",
    "accuracy.peers.MuJoCo.prepare",
    "control.QPSolver.update",
    "control.QPSolver.solve",
    "control.QPSolver.reset",
    *(f"integrate.{name}.advance_spans" for name in ("DOP853", "Integrator", "RK4", "Watched")),
    "Sensors.measure_rows",
    "deploy.CompiledGait.applied",
    "deploy.CompiledGait.reset",
    "integrate.Integrator.advance",
    "integrate.Integrator.shorten",
    "integrate.DOP853.shorten",
    "integrate.Watched.advance",
    "integrate.Watched.shorten",
    "integrate.RK4.step_function",
    "robustness.Distribution.draw",
    "robustness.Distribution.settings",
}


# ---- what calls share ----


class Constant(tc.control.Controller):
    """A controller of a user's own."""

    def _decide(self, time, state):
        return tc.control.Command(np.full(9, 40.0))


@cache
def folder():
    """A folder for files, which goes with the process."""
    holder = tempfile.TemporaryDirectory(prefix="fuzz-")
    return Path(holder.name), holder


def scratch(name):
    return folder()[0] / name


@cache
def frozen_mpc():
    return mpc(horizon=3)


@cache
def frozen_nmpc():
    return nmpc(horizon=2)


@cache
def frozen_linearizing():
    return linearizing()


def own_law(time, nodes, velocities):
    """A law of a user."""
    return gamma() + (prism().string_length(nodes) - prism().string_length(prism().nodes))


@cache
def own_controller():
    return tc.FunctionController(
        prism(), own_law, input="force_density", sample_time=0.02, equilibrium_input=gamma()
    )


def fresh(make):
    """A controller or filter as it was made."""

    def reset():
        value = make()
        value.reset()
        return value

    return reset


def command_after(controller):
    """A command for the structure at rest, which must be finite and within bounds."""
    value = controller.command(0.0, nodes(), STILL).value
    low, high = controller.bounds
    if not np.all((value >= low - 1e-9) & (value <= high + 1e-9)):
        return np.nan
    return value


def estimate_after(kalman):
    """An estimate from readings at rest."""
    return kalman.update(kalman.sensors.measure(nodes()))


@cache
def run():
    return tc.simulate(elastic(), 0.02, rest_length=rest_length(), step=1e-3)


@cache
def closed_run():
    return tc.simulate(
        elastic(),
        0.005,
        controller=winch_regulator(),
        estimator=estimator(),
        rest_length=rest_length(),
        winches=tc.Winches(motor=tc.Motor(drum_radius=0.01)),
        step=1e-3,
    )


@cache
def dropped_run():
    model = tc.Model(tc.prism(), gravity=9.81, ground=tc.Ground(stiffness=5e3, height=-1e-3))
    return tc.simulate(model, 0.02, force_density=np.full(9, 20.0), step=1e-3)


@cache
def struts_plant():
    """A prism on three fixed nodes, whose bars are driven."""
    foot = replace(prism(), fixed=[3, 4, 5])
    model = tc.Model(foot, tc.LinearStrings(stiffness=200.0))
    return tc.linearize(model, tc.prestress(foot, min_force_density=20.0), "bar_length")


@cache
def driven_run():
    plant, time = struts_plant(), [0.0, 0.02]
    grow = tc.Profile(time, np.outer(plant.equilibrium_input, [1.0, 1.01]), "cubic")
    return tc.simulate(plant.model, 0.02, rest_length=plant.rest_length, bar_length=grow, step=2e-3)


@cache
def standing():
    """The prism on the ground, light enough to stand."""
    ground = tc.Ground(stiffness=1e3, damping=0.5, friction=0.5)
    return tc.Model(prism(), strings=elastic().strings, gravity=0.5, ground=ground)


def gait():
    return tc.shape.RollingGait(standing(), rest_length(), [1.0, 0.0, 0.0], 0.02)


@cache
def case():
    return tc.Scene(elastic(), 0.02, rest_length=0.98 * rest_length())


def stepper() -> tc.Stepper:
    return tc.Stepper(elastic(), 0.02, step=0.01, rest_length=0.98 * rest_length())


def steppers() -> tc.Stepper:
    return tc.Stepper(elastic(), 0.02, step=0.01, rest_length=rest_length(), count=2)


@cache
def converged():
    return tc.accuracy.converged_motion(case(), outputs=5)


@cache
def compared():
    return tc.work_precision(
        case(), ["rk4"], {"rk4": [0.01, 0.005]}, reference=converged(), repeats=1, outputs=5
    )


@cache
def report():
    return tc.sweep(noisy, drawn(), 6, seed=1, executor=Inline())


def drawn():
    return {"mass": tc.Uniform(0.8, 1.2, size=3), "delay": tc.Normal(0.0, 0.1)}


@cache
def order():
    return tc.convergence_order(case(), "rk4", [0.01, 0.005], converged(), outputs=2)


@cache
def stable():
    return tc.stability_map("rk4", [1e3], [0.1], steps=20)


@cache
def drift():
    return tc.long_run(case(), "rk4", 1e-3, steps=30, outputs=30)


@cache
def predicted():
    return tc.predictability(case(), outputs=10)


@cache
def target():
    height = tc.Height(0.95, top=TOP, bottom=BOTTOM)
    return tc.shape_target(elastic(), height, force_density=17.3205)


@cache
def scene():
    return tc.load_scene(SCENE)


@cache
def resting_scene():
    return tc.load_scene(SCENE.with_name("prism_morph.toml"))


@cache
def generated():
    return tc.generate_c(regulator(), scratch("generated"))


@cache
def held_gamma():
    return tc.linearize(elastic(), rest())


@cache
def compiled():
    return generated().compile()


@cache
def skinned():
    return tc.skin(prism(), ["top"], iterations=1, node_mass=0.01)


@cache
def parts():
    return tc.subdivide(prism(), 2, node_mass=0.01)


@cache
def supported():
    return tc.net(3, 3, spacing=0.5, node_mass=0.1)


@cache
def symmetry():
    return tc.RotationalSymmetry([TOP, BOTTOM])


@cache
def drawing():
    return tc.plot.structure(prism())


def view():
    return tc.plot.view(run())


def reference():
    return tc.Reference([0.0, 1.0], np.repeat(nodes()[:, :, None], 2, axis=2))


def height():
    return tc.Height(0.95, top=TOP, bottom=BOTTOM)


# ---- structures and statics ----

call(
    "prism",
    lambda: {
        "sides": 3,
        "radius": 0.5,
        "height": 1.0,
        "top_radius": 0.4,
        "bar_mass": 1.0,
        "handedness": "left",
        "diagonals": False,
    },
)
call(
    "prism_tower",
    lambda: {
        "stages": 2,
        "sides": 3,
        "radius": 0.5,
        "height": 1.0,
        "bar_mass": 1.0,
        "overlap": 0.25,
        "handedness": "left",
    },
)
call("net", lambda: {"rows": 3, "columns": 3, "spacing": 0.5, "node_mass": 0.1, "fixed": [0, 8]})
call(
    "skin",
    lambda: {
        "structure": prism(),
        "panels": ["top"],
        "iterations": 1,
        "node_mass": 0.01,
        "group": "skin",
    },
)
call(
    "skin, areal",
    lambda: {"structure": prism(), "panels": ["top"], "iterations": 1, "areal_density": 0.1},
)
call("skin, panels", lambda: {"structure": prism(), "panels": [TOP], "panel_mass": [0.1]})
call("subdivide", lambda: {"structure": prism(), "segments": np.full(9, 2), "node_mass": 0.01})
call(
    "subdivide, mass",
    lambda: {"structure": prism(), "segments": 2, "string_mass": np.full(9, 0.01)},
)
call(
    "Structure",
    lambda: {
        "nodes": nodes(),
        "bars": prism().bars,
        "strings": prism().strings,
        "bar_mass": np.ones(3),
        "string_groups": prism().string_groups,
    },
)
call(
    "Structure, supported",
    lambda: {
        "nodes": supported().nodes,
        "bars": [],
        "strings": supported().strings,
        "bar_mass": [],
        "string_node_mass": np.full(5, 0.1),
        "fixed": [0, 2, 6, 8],
    },
)
call(
    "Structure, any class",
    lambda: {
        "nodes": [[0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0]],
        "bars": [(0, 1), (1, 2)],
        "strings": [(2, 3), (0, 3, 2)],
        "bar_mass": 1.0,
        "point_mass": [0.0, 0.0, 0.5, 0.2],
        "fixed": [0, (1, "y")],
    },
)
for _name in tc.library.__all__:
    if f"library.{_name}" in public():
        _parameters = signature(getattr(tc.library, _name)).parameters.values()
        _defaults = {each.name: each.default for each in _parameters}
        call(f"library.{_name}", partial(dict, _defaults))
call("Structure.bar_vectors", lambda: {"nodes": nodes()}, prism)
call(
    "Structure.from_matrices",
    lambda: {
        "nodes": nodes(),
        "C_b": (prism().C_b @ prism().C_nb).toarray(),
        "C_s": prism().C_s.toarray(),
        "bar_mass": 1.0,
        "string_groups": ["top"] * 9,
        "fixed": [0],
        "point_mass": np.zeros(6),
    },
    lambda: tc.Structure,
)
call("Structure.string_vectors", lambda: {"nodes": nodes()}, prism)
call("Structure.string_length", lambda: {"nodes": nodes()}, prism)
call("Structure.save", lambda: {"path": scratch("prism.toml")}, prism)
call(
    "Structure.load",
    lambda: {"path": str(tc.prism().save(scratch("saved.json")))},
    lambda: tc.Structure,
)
call("Structure.strings_in", lambda: {"group": "top"}, prism)
call("Structure.checked_nodes", lambda: {"name": "nodes", "nodes": nodes()}, prism)
call("structure.prism_radius", lambda: {"bar_length": 1.4, "height": 1.0, "sides": 3})
call("structure.restore_bar_lengths", lambda: {"structure": prism(), "nodes": 1.001 * nodes()})
call("structure.segment_counts", lambda: {"structure": parts()})
call(
    "structure.skin_rest_length",
    lambda: {
        "structure": skinned(),
        "rest_length": np.ones(len(skinned().parent.strings)),
        "prestretch": 0.1,
    },
)
call("structure.spread_force_density", lambda: {"structure": parts(), "force_density": gamma()})
call("structure.spread_rest_length", lambda: {"structure": parts(), "rest_length": rest_length()})
call(
    "prestress",
    lambda: {
        "structure": prism(),
        "force_density": 17.3205,
        "reference": "top",
        "external_force": STILL,
    },
)
call(
    "prestress, bounds",
    lambda: {"structure": prism(), "min_force_density": 5.0, "max_force_density": np.full(9, 80.0)},
)
call(
    "statics.Prestress.tangent_stiffness",
    lambda: {"stiffness": np.full(9, 100.0), "count": 2},
    rest,
)
call("prestress, array", lambda: {"structure": prism(), "force_density": gamma()})
call("statics.equilibrium_matrix", lambda: {"structure": prism(), "nodes": nodes()})
call(
    "statics.prism_force_density",
    lambda: {"sides": 3, "force_density": 10.0, "radius": 0.5, "top_radius": 0.4},
)
call(
    "statics.stress_matrix",
    lambda: {
        "structure": prism(),
        "force_density": gamma(),
        "bar_force_density": rest().bar_force_density,
    },
)

# ---- sizing ----


def soft():
    return tc.Material(modulus=60e9, density=2700.0, yield_stress=110e6)


def sized():
    return tc.sections(prism(), bars=soft(), strings=soft(), bar_radius=0.01, string_radius=1e-3)


call("Material", lambda: {"modulus": 60e9, "density": 2700.0, "yield_stress": 110e6})
call("sizing.Tube", lambda: {"ratio": 0.8, "wall_factor": 0.5, "least_wall": 1e-3})
call(
    "sections",
    lambda: {
        "structure": prism(),
        "bars": soft(),
        "strings": soft(),
        "bar_radius": 0.01,
        "string_radius": np.full(9, 1e-3),
        "bar_inner_radius": np.full(3, 0.005),
        "string_mass_to_nodes": True,
    },
)
call(
    "sections, areas",
    lambda: {
        "structure": prism(),
        "bars": soft(),
        "strings": soft(),
        "bar_area": np.full(3, 1e-4),
        "bar_inertia": 1e-9,
        "string_area": 1e-6,
    },
)
call(
    "sizing.Sections.margins",
    lambda: {"string_force": np.full(9, 10.0), "bar_force": np.full(3, 10.0)},
    sized,
)


def family():
    return tc.sizing.complexity({1: prism()}, least_design)


def least_design(structure):
    how = {"min_force_density": 10.0, "restarts": 1}
    return tc.design(structure, bars=soft(), strings=soft(), **how)


call(
    "sizing.complexity",
    lambda: {"family": {1: prism()}, "sized": least_design},
)
call(
    "plot.least_mass",
    lambda: {"found": family(), "xlabel": "stages", "ax": flat()},
    share=0.2,
)
call("sizing.symmetry_groups", lambda: {"structure": prism()})
call("sizing.length_groups", lambda: {"structure": prism()})
call(
    "design",
    lambda: {
        "structure": prism(),
        "bars": soft(),
        "strings": soft(),
        "loads": [STILL],
        "safety": 1.5,
        "min_force_density": 10.0,
        "tube": tc.sizing.Tube(0.8),
        "least_radius": 1e-3,
        "groups": {"strings": [[0, 1, 2], [3, 4]], "bars": [[0, 1, 2]]},
        "common_prestress": True,
        "restarts": 1,
        "seed": 1,
    },
)


call(
    "rigidity",
    lambda: {
        "plant": tc.linearize(elastic(), rest(), input="rest_length"),
        "axial_rigidity": np.full(3, 1e6),
        "count": 3,
    },
)


def stretched():
    pull = np.zeros((3, 6))
    pull[2] = [1.0, 1.0, 1.0, -1.0, -1.0, -1.0]
    return pull


call(
    "deflections",
    lambda: {"model": elastic(), "at": rest(), "loads": [stretched()], "rest_length": None},
    share=0.2,
)
call(
    "stiffness_along",
    lambda: {"model": elastic(), "at": rest(), "directions": [stretched()], "rest_length": None},
    share=0.3,
)
call(
    "plot.deflections",
    lambda: {
        "found": tc.deflections(elastic(), rest(), [stretched()]),
        "load": 0,
        "magnify": 5.0,
        "ax": space(),
    },
    share=0.1,
)


def strong():
    return tc.strength(run(), sized())


call("strength", lambda: {"run": run(), "sections": sized()}, share=0.3)
call("plot.utilization", lambda: {"found": strong(), "time": 0.0, "ax": space()}, share=0.1)
call("simulation.Strength.failure", lambda: {"margin": 1.5}, strong, share=0.3)
call("plot.strength", lambda: {"found": strong(), "members": 3, "ax": flat()}, share=0.2)

# ---- derivatives of runs ----


def differentiable():
    return tc.simulate(elastic(), 0.02, rest_length=rest_length(), step=1e-3)


call(
    "sensitivity",
    lambda: {"run": differentiable(), "to": ["rest_length", "stiffness"], "times": [0.01, 0.02]},
    share=0.3,
)
call(
    "gradient",
    lambda: {
        "run": differentiable(),
        "cost": lambda time, nodes, velocities: nodes[2, 3],
        "to": ["bar_mass"],
        "times": 0.02,
    },
    share=0.3,
)


def read_by():
    return tc.Sensors(structure=prism(), node_position=1e-3)


def logged():
    return tc.Log.of_run(differentiable(), read_by(), [0.01, 0.02], seed=0)


def fitted():
    return tc.fit(elastic(), logged(), ["stiffness"], groups={"stiffness": "all"})


call(
    "Log",
    lambda: {
        "time": [0.01, 0.02],
        "readings": np.ones((2, 18)),
        "sensors": read_by(),
        "rest_length": rest_length(),
        "nodes": prism().nodes,
        "velocities": STILL,
        "external_force": None,
    },
)
call(
    "Log, force density",
    lambda: {
        "time": [0.01, 0.02],
        "readings": np.ones((2, 18)),
        "sensors": read_by(),
        "force_density": np.full(9, 10.0),
    },
)
call("Log.until", lambda: {"time": 0.015}, logged)
call("Log.windows", lambda: {"length": 0.015, "run": differentiable()}, logged, share=0.3)
call(
    "Log.of_run",
    lambda: {"run": differentiable(), "sensors": read_by(), "times": [0.01, 0.02], "seed": 1},
    logged,
    share=0.3,
)
call("optimize.LogNormal", lambda: {"median": 300.0, "deviation": 0.5})
call(
    "exciting_input",
    lambda: {
        "told": tc.identifiable(elastic(), logged(), ["stiffness"], step=5e-3),
        "winches": tc.Winches(rate=0.1),
        "parts": 2,
        "most_rollouts": 4,
        "seed": 1,
        "progress": False,
    },
    share=0.2,
)
for name in ("fit", "identifiable"):
    call(
        name,
        lambda name=name: (
            {
                "model": elastic(),
                "log": logged(),
                "parameters": {"stiffness": 0.5},
                "known": {"stiffness": [0, 1]},
                "groups": {"stiffness": [[2, 3, 4], [5, 6, 7, 8]]},
                "start": (0.01, 0.1),
                "tolerance": 1e-6,
                "step": None,
            }
            | ({"loss": "huber", "most_rollouts": 20, "progress": False} if name == "fit" else {})
        ),
        share=0.2,
    )
call("Log.save", lambda: {"file": scratch("log.csv")}, logged, share=0.3)
call(
    "Log.read",
    lambda: {
        "file": str(logged().save(scratch("read.csv"))),
        "sensors": read_by(),
        "rest_length": rest_length(),
    },
    logged,
    share=0.3,
)
call("optimize.Fit.save", lambda: {"file": scratch("fit.json")}, fitted, share=0.2)
call("optimize.Fit.validate", lambda: {"log": logged()}, fitted, share=0.2)
call("plot.residuals", lambda: {"found": fitted().residuals[0], "ax": flat()}, share=0.2)
call("plot.intervals", lambda: {"found": fitted(), "ax": flat()}, share=0.2)

# ---- optimal motions ----


def on_rail(place):
    nodes = [[-2.0, place, 2.0], [0.0, 0.0, 0.0]]
    fixed, mass = [0, 2, (1, "y")], [0.0, 2.0, 0.0]
    rail = tc.Structure(nodes, [], [[0, 1], [1, 2]], None, fixed=fixed, point_mass=mass)
    return tc.prestress(rail, 10 / np.array([2 + place, 2 - place]))


def along_rail():
    return {
        "model": tc.Model(on_rail(-0.2).structure, strings=tc.LinearStrings(100.0, 1.0)),
        "start": on_rail(-0.2),
        "goal": on_rail(0.2),
        "winches": tc.Winches(rate=1.0),
        "intervals": 4,
        "tolerance": 1e-2,
    }


@cache
def planned():
    return tc.optimal_motion(**along_rail())


call(
    "optimal_motion",
    lambda: (
        along_rail()
        | {
            "minimize": "effort",
            "duration": 1.0,
            "input": "rest_length",
            "min_force_density": 0.1,
            "max_force_density": np.full(2, 90.0),
            "max_tension": 100.0,
            "max_power": np.full(2, 100.0),
            "min_clearance": None,
            "obstacles": lambda nodes: 5.0 - nodes[0, 1],
            "plant": tc.linearize(along_rail()["model"], on_rail(-0.2), input="rest_length"),
            "cost_tolerance": 0.5,
            "refinements": 1,
            "most_iterations": 50,
            "progress": False,
        }
    ),
    share=0.1,
)
call("optimize.OptimalMotion.at", lambda: {"time": 0.1}, planned)
call("optimize.OptimalMotion.reference", lambda: {"times": [0.0, 0.1]}, planned, share=0.3)
call("optimize.OptimalMotion.goal_distance", lambda: {"nodes": planned().nodes}, planned)
call("plot.optimal_motion", lambda: {"motion": planned(), "axes": None}, share=0.1)

# ---- dynamics and actuation ----

call("LinearStrings", lambda: {"stiffness": np.full(9, 100.0), "damping": np.full(9, 0.1)})
call("ElasticStrings", lambda: {"axial_rigidity": np.full(9, 100.0), "damping": 0.1})
for law in (lambda: tc.LinearStrings(100.0, 0.1), lambda: tc.ElasticStrings(np.full(9, 100.0))):
    kind = type(law()).__name__
    call(
        f"dynamics.StringLaw.force_density, {kind}",
        lambda: {"length": np.ones(9), "rest_length": np.full(9, 0.9), "rate": np.zeros(9)},
        law,
    )
    call(
        f"dynamics.StringLaw.rest_length, {kind}",
        lambda: {"length": np.ones(9), "force_density": np.full(9, 9.0)},
        law,
    )
    call(f"dynamics.StringLaw.for_count, {kind}", lambda: {"count": 9}, law)
call(
    "Ground",
    lambda: {
        "stiffness": 5e3,
        "damping": 0.3,
        "friction": 0.5,
        "slip_speed": 0.01,
        "normal": [0.0, 0.1, 1.0],
        "height": -0.5,
        "nodes": [0, 1, 2],
    },
)
call("dynamics.HertzGround", lambda: {"stiffness": 1e5, "friction": 0.5, "nodes": [3]})
call("dynamics.SmoothGround", lambda: {"stiffness": 1e3, "damping": 0.1, "width": 0.02})
call(
    "Model, grounded",
    lambda: {
        "structure": prism(),
        "gravity": 9.81,
        "ground": [tc.Ground(5e3), tc.Ground(1e3, normal=[1.0, 0.0, 0.0], height=-2.0)],
    },
)
call(
    "Model",
    lambda: {
        "structure": prism(),
        "strings": tc.LinearStrings(100.0),
        "external_force": False,
        "gravity": [0.0, 0.0, 0.0],
    },
)
call(
    "Model, loaded",
    lambda: {
        "structure": supported(),
        "strings": tc.ElasticStrings(np.full(12, 9.0)),
        "external_force": np.zeros((3, 9)),
        "gravity": 9.81,
    },
)
call("Model.mass_matrix", on=elastic)
call("Model.symbolic", lambda: {"input": "rest_length", "parameters": ["damping"]}, elastic)
call("Model.replace", lambda: {"gravity": 9.81}, elastic)
call("Model.of_all_nodes", lambda: {"name": "kinetic_energy"}, elastic)
call("Model.state_equation", lambda: {"input": "rest_length"}, elastic)
call(
    "Model.equation",
    lambda: {"input": "force_density", "external_force": STILL, "form": "flat"},
    loaded,
)
call(
    "Profile",
    lambda: {"time": [0.0, 1.0], "values": np.ones((9, 2)), "interpolation": "linear"},
)
for name in ("at", "rate"):
    call(f"Profile.{name}", lambda: {"time": 0.5}, lambda: tc.Profile([0.0, 1.0], np.ones((9, 2))))
call("dynamics.coordinates", lambda: {"model": model(), "nodes": nodes(), "kind": "internal"})
call(
    "dynamics.Coordinates.project",
    lambda: {"displacements": np.full(18, 0.01)},
    lambda: plant().coordinates,
)
for kind in ("internal", "nodes", "minimal"):
    call(
        f"dynamics.Coordinates.measure, {kind}",
        lambda: {"nodes": nodes(), "velocities": STILL},
        lambda kind=kind: plant(kind).coordinates,
    )
    call(
        f"dynamics.Coordinates.to_nodes, {kind}",
        lambda kind=kind: {"q": np.full(plant(kind).degrees_of_freedom, 0.01)},
        lambda kind=kind: plant(kind).coordinates,
    )
    for name in ("to_motion", "to_velocities"):
        call(
            f"dynamics.Coordinates.{name}, {kind}",
            lambda kind=kind: {
                "q": np.full(plant(kind).degrees_of_freedom, 0.01),
                "rates": np.full(plant(kind).degrees_of_freedom, 0.01),
            },
            lambda kind=kind: plant(kind).coordinates,
        )
call("dynamics.compiled", lambda: {"function": equation().slope, "timeout": 60.0}, share=0.1)
call(
    "to_force_density", lambda: {"model": elastic(), "nodes": nodes(), "rest_length": rest_length()}
)
call("to_rest_length", lambda: {"model": elastic(), "nodes": nodes(), "force_density": gamma()})
call(
    "Winches",
    lambda: {
        "rate": np.full(9, 0.5),
        "shortest": np.full(9, 0.1),
        "longest": 2.0,
        "ramp": True,
        "substeps": 5,
        "motor": None,
    },
)
call(
    "Motor",
    lambda: {
        "drum_radius": np.full(9, 0.01),
        "gear_ratio": 20.0,
        "torque": 1.0,
        "speed": 100.0,
        "inertia": 1e-6,
        "lag": 0.01,
        "backlash": np.full(9, 0.1),
        "zero": 0.8,
    },
)
call(
    "Motor.angle",
    lambda: {"rest_length": rest_length(), "zero": 0.8},
    lambda: tc.Motor(0.01),
)
call(
    "Motor.rest_length",
    lambda: {"angle": np.full(9, 3.0), "zero": np.full(9, 0.8)},
    lambda: tc.Motor(0.01),
)
call(
    "Winches.move",
    lambda: {"current": rest_length(), "wanted": 1.1 * rest_length(), "sample_time": 0.01},
    lambda: tc.Winches(rate=0.5, shortest=0.1, longest=np.full(9, 2.0)),
)
call(
    "Winches.range",
    lambda: {"count": 9},
    lambda: tc.Winches(shortest=0.1, longest=np.full(9, 2.0)),
)
call(
    "Winches.refuse_out_of_range",
    lambda: {"name": "rest_length", "rest_length": rest_length()},
    lambda: tc.Winches(shortest=0.1, longest=np.full(9, 2.0)),
)

# ---- integrators ----

MAKE = {name.upper(): name for name in ("rk4", "dop853", "cvodes")}
MAKE |= {"EnergyMomentum": "energy_momentum"}


@cache
def integrator(name):
    return METHODS[name].integrator(
        equation(), {"step": 1e-3, "tolerance": 1e-6}[METHODS[name].setting]
    )


for kind, method in MAKE.items():
    setting = METHODS[method].setting
    given = {setting: {"step": 1e-3, "tolerance": 1e-6}[setting]}
    if METHODS[method].projects or METHODS[method].drifts:
        given["project"] = True
    call(f"integrate.{kind}", lambda given=given: dict(equation=equation(), **given), share=0.2)
    call(
        f"integrate.{kind}.advance",
        lambda: {
            "state": case().state,
            "held": case().input_value,
            "duration": 0.002,
            "outputs": 2,
        },
        lambda method=method: integrator(method),
        share=0.3,
    )
call("integrate.EnergyMomentum, step", lambda: {"equation": equation(), "step": 1e-3}, share=0.2)
call(
    "integrate.Method",
    lambda: {
        "name": "rk4",
        "settings": ("step",),
        "about": "order 4",
        "make": tc.integrate.RK4,
        "drifts": True,
        "projects": False,
        "differentiates": False,
    },
)
call(
    "integrate.Method.integrator",
    lambda: {
        "equation": equation(),
        "value": 1e-3,
        "setting": "step",
        "project": False,
    },
    lambda: METHODS["rk4"],
    share=0.3,
)

# ---- plant ----

call(
    "linearize",
    lambda: {
        "model": elastic(),
        "at": rest(),
        "input": "rest_length",
        "coordinates": "internal",
        "require_equilibrium": True,
        "actuated": [0, 8],
    },
    share=0.3,
)
call(
    "OperatingPoint", lambda: {"nodes": nodes(), "force_density": gamma(), "external_force": STILL}
)
call(
    "linearize, point",
    lambda: {"model": loaded(), "at": tc.OperatingPoint(nodes(), gamma(), STILL)},
    share=0.3,
)
call("modes", lambda: {"plant": plant(), "count": 2})
call("reduce", lambda: {"plant": plant(), "modes": [3, 4]})
call("controllability", lambda: {"plant": plant(), "count": 3})
call("energy_weights", lambda: {"plant": plant(), "by_mode": True})
call("plant.natural_weights", lambda: {"plant": plant()})
call(
    "equilibrium",
    lambda: {"model": elastic(), "rest_length": 0.98 * rest_length(), "nodes": nodes()},
    share=0.2,
)
call(
    "equilibrium, forces",
    lambda: {"model": loaded(), "force_density": gamma(), "external_force": STILL},
    share=0.2,
)


call(
    "equilibrium, ground",
    lambda: {"model": standing(), "rest_length": 0.9 * rest_length(), "settle": True},
    share=0.2,
)
call("plant.set_down", lambda: {"model": standing(), "feet": np.array([3, 4, 5]), "nodes": nodes()})
call("plant.command_parents", lambda: {"plant": parts_plant(), "actuated": [0, 8]}, share=0.3)
call("plant.in_coordinates", lambda: {"plant": plant(), "kind": "minimal"})


@cache
def parts_plant():
    split = tc.Model(parts(), strings=tc.LinearStrings(100.0))
    at = tc.prestress(parts(), tc.structure.spread_force_density(parts(), gamma()))
    return tc.linearize(split, at, input="rest_length")


call("actuator_choice", lambda: {"plant": plant(), "count": 3})
call("plant.ActuatorChoice.table", on=lambda: tc.actuator_choice(plant()))
call(
    "actuation.Actuation.strings",
    lambda: {"inputs": gamma()[:3]},
    lambda: tc.linearize(elastic(), rest(), actuated=[0, 1, 2]).actuation,
)
call(
    "actuation.Actuation.inputs",
    lambda: {"strings": gamma()},
    lambda: tc.linearize(elastic(), rest(), actuated=[0, 1, 2]).actuation,
)
call("plant.Controllability.table", on=lambda: tc.controllability(plant()))
call("plant.Modes.table", on=lambda: tc.modes(plant()))
call("plant.LinearPlant.measure", lambda: {"nodes": nodes(), "velocities": STILL}, plant)
call("plant.LinearPlant.to_nodes", lambda: {"q": np.zeros(9)}, plant)
call("plant.LinearPlant.to_velocities", lambda: {"q": np.zeros(9), "rates": np.zeros(9)}, plant)
call("plant.LinearPlant.discretize", lambda: {"sample_time": 0.01}, plant)
call("plant.LinearPlant.to_statespace", lambda: {"dt": 0.01, "outputs": "state"}, plant)
call(
    "Reference",
    lambda: {
        "time": [0.0, 1.0],
        "nodes": np.repeat(nodes()[:, :, None], 2, axis=2),
        "force_density": np.repeat(gamma()[:, None], 2, axis=1),
    },
)
call("Reference.reversed", on=reference)
call("Reference.then", lambda: {"other": reference(), "pause": 0.5}, reference)

# ---- control ----

call(
    "LQR",
    lambda: {
        "plant": plant(),
        "Q": np.ones(18),
        "R": np.eye(9),
        "N": np.full((18, 9), 0.01),
        "sample_time": 0.01,
        "max_force_density": np.full(9, 50.0),
        "max_change": 1.0,
    },
    share=0.5,
)
call(
    "LQR, winches",
    lambda: {
        "plant": held_plant(),
        "sample_time": 0.01,
        "winches": tc.Winches(rate=0.5, shortest=0.1),
    },
    share=0.5,
)
call("LQR.to_statespace", on=regulator)
call("control.Controller.twin", on=regulator)
call(
    "control.LinearController",
    lambda: {
        "plant": plant(),
        "system": tc.LQR(plant(), sample_time=0.01).to_statespace(),
        "sees": "state",
        "max_force_density": np.full(9, 50.0),
        "max_change": 1.0,
    },
    share=0.5,
)
call(
    "control.held_loop",
    lambda: {"plant": held_gamma(), "gain": regulator().gain, "sample_time": 0.001},
)
call(
    "control.Controller",
    lambda: {
        "plant": plant(),
        "sample_time": 0.01,
        "low": np.zeros(9),
        "high": np.full(9, 50.0),
        "change": np.full(9, 2.0),
    },
    lambda: SimpleNamespace(Controller=Constant),
)
SETTINGS = {
    "horizon": 2,
    "sample_time": 0.02,
    "max_force_density": np.full(9, 50.0),
    "Q": np.ones(18),
    "R": 1.0,
    "N": np.full((18, 9), 0.01),
    "terminal_weight": np.ones(18),
    "max_change": 5.0,
    "min_force_density": 1.0,
    "max_tension": 60.0,
    "string_penalty": 100.0,
    "load_gain": 0.1,
    "tolerance": 1e-4,
    "max_iterations": 4000,
    "time_limit": 1.0,
    "solver": "auto",
}
call(
    "control.MPCSettings",
    lambda: (
        SETTINGS
        | {
            "outputs": [output_limit()],
            "reference": nodes(),
            "tracked": np.eye(18)[:3],
            "winches": None,
        }
    ),
)
call("MPC", lambda: dict(plant=plant(), **SETTINGS), share=0.4)
call(
    "MPC, winches",
    lambda: {
        "plant": held_plant(),
        "horizon": 2,
        "sample_time": 0.02,
        "winches": tc.Winches(rate=0.5, shortest=0.1),
        "outputs": [output_limit()],
        "reference": nodes(),
        "tracked": np.eye(18)[:2],
        "load_gain": 0.5,
    },
    share=0.3,
)
call(
    "NMPC",
    lambda: dict(
        plant=plant(),
        iterations=1,
        machine_code=False,
        linearization_tolerance=0.01,
        **(SETTINGS | {"load_gain": None}),  # N goes without
    ),
    share=0.1,
)
call(
    "FeedbackLinearization",
    lambda: {
        "plant": plant(),
        "reference": reference(),
        "sample_time": 0.02,
        "max_force_density": np.full(9, 50.0),
        "frequency": 1.0,
        "damping": 1.0,
        "tracked": np.eye(18)[:3],
        "max_change": 5.0,
        "regularization": 1e-4,
        "tolerance": 1e-7,
        "max_iterations": 4000,
    },
    share=0.2,
)
call(
    "FunctionController",
    lambda: {
        "structure": prism(),
        "function": own_law,
        "input": "force_density",
        "sample_time": 0.02,
        "low": 1.0,
        "high": np.full(9, 60.0),
        "max_change": 5.0,
        "equilibrium_input": gamma(),
    },
)
call(
    "OutputLimit",
    lambda: {
        "matrix": np.eye(18)[:2],
        "low": np.full(2, -2.0),
        "high": np.full(2, 2.0),
        "penalty": 10.0,
        "of": "nodes",
    },
)
call("control.buckling", lambda: {"sections": sized(), "safety": 2.0, "penalty": 10.0})
call("clearance", lambda: {"plant": plant(), "clearance": 0.05, "penalty": 10.0})


@cache
def output_limit():
    return tc.OutputLimit(np.eye(18)[:1], low=[-2.0], high=[2.0])


CONTROLLERS = {
    "control.Controller": regulator,
    "MPC": frozen_mpc,
    "NMPC": frozen_nmpc,
    "FeedbackLinearization": frozen_linearizing,
    "FunctionController": own_controller,
    "deploy.CompiledController": compiled,
}
for kind, make in CONTROLLERS.items():
    on = fresh(make)
    share = 0.05 if "deploy" in kind else 0.5
    after = lambda make=make: command_after(make())  # noqa: E731
    base = "control.BaseController"
    call(
        f"{base}.command, {kind}",
        lambda: {"time": 0.02, "nodes": nodes(), "velocities": STILL},
        on,
        share,
        after,
    )
    own = base if kind in ("control.Controller", "MPC", "NMPC", "FeedbackLinearization") else kind
    call(f"{own}.applied, {kind}", lambda: {"value": gamma()}, on, share, after)
    own = base if kind == "control.Controller" else kind
    call(f"{own}.reset", on=on, share=0.1, after=after)
    if f"{kind}.follow" in members():
        call(f"{kind}.follow", lambda: {"reference": reference()}, on, share, after)
call(
    "control.BaseController.fall_back",
    lambda: {"status": tc.control.Status.INPUT_NOT_FINITE},
    fresh(regulator),
    after=lambda: command_after(regulator()),
)
call(
    "FeedbackLinearization.error",
    lambda: {"time": 0.0, "nodes": nodes(), "velocities": STILL},
    fresh(frozen_linearizing),
)
call(
    "NMPC.targets",
    lambda: {"time": 0.0},
    fresh(frozen_nmpc),
    0.5,
    lambda: command_after(frozen_nmpc()),
)


def qp():
    return frozen_mpc().program(0.02, nodes(), STILL)


call(
    "MPC.program",
    lambda: {"time": 0.02, "nodes": nodes(), "velocities": STILL},
    fresh(frozen_mpc),
    0.5,
    lambda: command_after(frozen_mpc()),
)
call(
    "control.QuadraticProgram.inputs",
    lambda: {"x": np.zeros(len(qp().q))},
    qp,
)
call("NMPC.prepare", on=fresh(frozen_nmpc), share=0.1, after=lambda: command_after(frozen_nmpc()))

# ---- estimation ----

call(
    "Sensors",
    lambda: {
        "structure": prism(),
        "node_position": 0.01,
        "string_length": np.full(2, 0.01),
        "bar_direction": 0.01,
        "string_tension": [0.1],
        "bar_rate": 0.05,
        "nodes": [1, 4],
        "strings": [0, 3],
        "bars": [2],
        "tension_strings": [3],
        "rate_bars": [0, 1],
        "delay": 1,
        "drop_rate": 0.1,
        "outlier_rate": 0.1,
    },
)
call(
    "Sensors, of a robot",
    lambda: {
        "structure": prism(),
        "bar_inclination": 0.01,
        "gyroscope": 0.02,
        "accelerometer": 0.1,
        "node_range": 0.02,
        "encoder": 0.1,
        "inclination_bars": [0, 1],
        "gyroscope_bars": [2],
        "accelerometer_nodes": [0, 3],
        "range_nodes": [1],
        "encoder_strings": [0, 4],
        "anchors": np.array([[0.0, 2.0], [0.0, 1.0], [3.0, 3.0]]),
        "motor": tc.Motor(drum_radius=0.01, zero=0.9),
        "gravity": 9.81,
        "bias": {"gyroscope": (0.05, 1e-3)},
    },
)
call(
    "Sensors.draw_bias",
    lambda: {"generator": np.random.default_rng(0), "sample_time": 0.01, "before": np.zeros(9)},
    lengths,
)
call("Sensors.needs", lambda: {"part": "tension"}, lengths)
call("Sensors.count_of", lambda: {"chooser": "nodes"}, lengths)
call("Sensors.measure", lambda: {"nodes": nodes(), "tension": None}, lengths)
call(
    "Sensors.measure, tension",
    lambda: {"nodes": nodes(), "tension": np.ones(9)},
    lambda: tc.Sensors(structure=prism(), string_tension=0.1),
)
call(
    "Sensors.measure, velocities",
    lambda: {"nodes": nodes(), "velocities": 0.0 * nodes()},
    lambda: tc.Sensors(structure=prism(), bar_rate=0.05),
)
call(
    "Sensors.disturb", lambda: {"exact": np.ones(9), "generator": np.random.default_rng(0)}, lengths
)
call(
    "KalmanFilter",
    lambda: {
        "plant": held_plant(),
        "sensors": tc.Sensors(structure=prism(), string_length=0.01, string_tension=0.1),
        "sample_time": 0.01,
        "process_noise": 0.02,
        "load": False,
        "load_noise": 0.05,
        "prediction": "linear",
        "rolling": False,
        "gate": 1e-4,
        "patience": 5,
        "start": 0.0 * nodes() + nodes(),
        "start_spread": 0.03,
        "rest_length_error": (1e-3, 1e-4),
    },
    share=0.3,
)
call("estimation.Observability.table", on=lambda: estimator().observability())
call(
    "estimation.Observability.told_by",
    lambda: {"direction": "shape 0 at 2.319 Hz"},
    lambda: estimator().observability(),
    0.3,
)
call("KalmanFilter.observability", lambda: {"duration": 0.1}, estimator, 0.3)
call(
    "KalmanFilter.smooth",
    lambda: {
        "readings": np.tile(lengths().measure(nodes())[:, None], 3),
        "held": np.tile(rest_length()[:, None], 3),
        "previous": rest_length(),
    },
    estimator,
    0.3,
)
call(
    "KalmanFilter, winches",
    lambda: {
        "plant": held_plant(),
        "sensors": lengths(),
        "sample_time": 0.01,
        "prediction": "nonlinear",
        "winches": tc.Winches(substeps=2),
    },
    share=0.1,
)
call(
    "KalmanFilter.update",
    lambda: {"measurement": lengths().measure(nodes())},
    fresh(estimator),
    0.5,
    lambda: estimate_after(estimator()),
)
call(
    "KalmanFilter.predict",
    lambda: {"held": rest_length(), "force": 0.1 * nodes()},
    fresh(estimator),
    0.5,
    lambda: estimate_after(estimator()),
)
call(
    "KalmanFilter.reset",
    lambda: {"state": np.full(18, 1e-3), "covariance": np.eye(18), "held": rest_length()},
    estimator,
    0.5,
    lambda: estimate_after(estimator()),
)

# ---- shapes ----

call(
    "Height",
    lambda: {
        "height": 0.9,
        "top": TOP,
        "bottom": BOTTOM,
        "axis": [0.0, 0.0, 1.0],
        "tolerance": 0.01,
    },
)
call("Twist", lambda: {"angle": 0.1, "top": TOP, "bottom": BOTTOM, "tolerance": 0.01})
call(
    "NodesAt",
    lambda: {"nodes": TOP, "positions": nodes()[:, :3], "directions": "xyz", "tolerance": 0.01},
)
call(
    "shape.PointAt",
    lambda: {
        "nodes": [0, 1],
        "position": np.zeros(3),
        "weights": [0.5, 0.5],
        "directions": "xyz",
        "tolerance": 0.01,
    },
)
call(
    "RotationalSymmetry",
    lambda: {"cycles": [TOP, BOTTOM], "axis": [0.0, 0.0, 1.0], "centre": np.zeros(3), "turns": 1},
)
call("RotationalSymmetry.rotation", on=symmetry)
call("RotationalSymmetry.permutation", lambda: {"count": 6}, symmetry)
call("shape.Demand.refuse_other_nodes", lambda: {"name": "demands", "structure": prism()}, height)
call(
    "shape_target",
    lambda: {
        "model": elastic(),
        "demands": [height()],
        "force_density": 17.3205,
        "reference": "top",
        "prestress": "centred",
        "min_force_density": 1.0,
        "max_force_density": 60.0,
        "min_clearance": 0.01,
        "symmetry": symmetry(),
        "start": nodes(),
        "place": "anywhere",
        "require_stable": True,
    },
    share=0.1,
)
call(
    "shape_path",
    lambda: {
        "model": elastic(),
        "start": rest(),
        "goal": target(),
        "duration": 1.0,
        "step": 0.5,
        "ramp": 0.25,
        "winches": tc.Winches(shortest=0.1, longest=2.0),
        "min_force_density": 1.0,
        "max_force_density": 60.0,
        "place": "centre",
        "require_stable": True,
    },
    share=0.1,
)
call(
    "shape.tipping_path",
    lambda: {
        "model": standing(),
        "rest_length": rest_length(),
        "feet": [3, 4, 5],
        "direction": [1.0, 0.0, 0.0],
        "nodes": nodes(),
        "winches": tc.Winches(shortest=0.1, longest=2.0),
        "margin": 0.01,
        "step": 0.02,
        "clearance": 0.01,
    },
    share=0.2,
)
call(
    "shape.RollingGait",
    lambda: {
        "model": standing(),
        "rest_length": rest_length(),
        "direction": [1.0, 0.0, 0.0],
        "sample_time": 0.02,
        "winches": tc.Winches(rate=0.1),
        "steps": 3,
        "clearance": 0.01,
        "tabulated": False,
    },
    share=0.2,
)
call("shape.RollingGait.reset", on=gait)
call("shape.RollingGait.begin", lambda: {"model": standing(), "nodes": nodes()}, gait)
call("shape.RollingGait.applied", lambda: {"value": rest_length()}, gait)
call(
    "shape.RollingGait.command",
    lambda: {"time": 0.02, "nodes": nodes(), "velocities": STILL},
    gait,
    0.2,
)
call("shape.ShapePath.reference", lambda: {"times": [0.0, 0.25, 0.5]}, short_path)
call("shape.ShapePath.plants", lambda: {"count": 2, "input": "rest_length"}, short_path, 0.1)

# ---- simulation ----

call(
    "simulate",
    lambda: {
        "model": elastic(),
        "duration": 0.01,
        "nodes": nodes(),
        "velocities": STILL,
        "rest_length": rest_length(),
        "method": "rk4",
        "step": 1e-3,
        "output_step": 0.002,
        "project": True,
        "limits": tc.HealthLimits(),
        "progress": False,
    },
    share=0.4,
)
call(
    "simulate, adaptive",
    lambda: {
        "model": loaded(),
        "duration": 0.01,
        "force_density": gamma(),
        "external_force": STILL,
        "tolerance": 1e-6,
    },
    share=0.3,
)
call(
    "simulate, closed loop",
    lambda: {
        "model": elastic(),
        "duration": 0.004,
        "controller": winch_regulator(),
        "input": "rest_length",
        "rest_length": rest_length(),
        "winches": tc.Winches(rate=0.5),
        "step": 1e-3,
        "estimator": estimator(),
        "sensors": lengths(),
        "seed": 1,
        "faults": [tc.CutString(3, 0.002)],
    },
    share=0.3,
)
call("CutString", lambda: {"string": 3, "time": 1.0})
call("StuckWinch", lambda: {"string": 5, "time": 0.8, "until": 1.5})
call("LostMeasurement", lambda: {"time": 0.5, "until": 0.7})
call(
    "HealthLimits",
    lambda: {
        "energy_error": 0.05,
        "momentum_change": 1.0,
        "angular_momentum_change": 1.0,
        "bar_length_error": 1e-3,
        "position_error": 0.1,
        "steps": 1e6,
        "evaluations": 1e6,
        "switches": 100,
        "action": "warn",
        "penetration": 0.25,
        "fall": 1.0,
        "impulse_error": 0.1,
        "rest_length_error": 0.002,
    },
)
call("HealthLimits.passed", lambda: {"health": run().health}, tc.HealthLimits)
call(
    "simulate_many",
    lambda: {
        "scene": tc.Scene(
            elastic(), 0.01, rest_length=rest_length(), integration=tc.Integration(step=1e-3)
        ),
        "vary": {"stiffness": np.array([90.0, 100.0])},
        "keep_nodes": [0, 2],
        "threads": 1,
        "progress": False,
    },
    share=0.3,
)


def two_runs():
    return tc.simulate_many(
        tc.Scene(elastic(), 0.01, rest_length=rest_length(), integration=tc.Integration(step=1e-3)),
        {"nodes": np.array([nodes(), nodes()])},
    )


call(
    "simulation.Batch.trajectory",
    lambda: {"run": 1, "limits": tc.HealthLimits()},
    two_runs,
    share=0.3,
)
call("simulation.Batch.scene_of", lambda: {"run": 1}, two_runs, share=0.3)
call("simulation.Trajectory.summary", on=run)
call("simulation.Trajectory.save", lambda: {"path": scratch("run.npz")}, run, 0.3)
call("simulation.Trajectory.to_csv", lambda: {"path": scratch("run.csv")}, run, 0.3)
call("simulation.Trajectory.to_xarray", on=run, share=0.1)
call("simulation.Trajectory.to_pandas", on=run, share=0.1)
call("load_run", lambda: {"path": str(run().save(scratch("saved.npz")))}, share=0.3)
call("show_config", share=0.3)
call("simulation.ControlRecord.summary", on=lambda: closed_run().control)
call("simulation.ContactRecord.summary", on=lambda: dropped_run().contacts)
call("simulation.StrutRecord.summary", on=lambda: driven_run().struts)
call(
    "shape.strut_path",
    lambda: {
        "plant": struts_plant(),
        "bar_length": np.outer(struts_plant().equilibrium_input, [0.99, 1.0]),
        "time": [0.0, 1.0],
    },
    share=0.1,
)
call(
    "Stepper",
    lambda: {
        "model": elastic(),
        "sample_time": 0.02,
        "step": 0.01,
        "rest_length": 0.98 * rest_length(),
        "nodes": nodes(),
        "velocities": STILL,
        "winches": tc.Winches(rate=0.1, ramp=True),
        "actuated": None,
        "count": None,
        "parameters": {"stiffness": 90.0, "bar_mass": [1.0, 1.1, 1.2]},
        "sensors": tc.Sensors(structure=elastic().structure, string_length=0.01),
        "seed": 1,
    },
    share=0.3,
)
call(
    "vector_env",
    lambda: {
        "model": elastic(),
        "task": tc.learning.Reach(0, [0.5, 0.0, 0.9]),
        "sample_time": 0.02,
        "step": 0.01,
        "winches": tc.Winches(rate=0.1, shortest=0.2, longest=2.0),
        "rest_length": 0.98 * rest_length(),
        "nodes": nodes(),
        "actuated": None,
        "count": 2,
        "duration": 1.0,
        "turned": True,
        "vary": {"stiffness": tc.Uniform(90.0, 110.0)},
        "autoreset": "same_step",
        "render_mode": None,
    },
    share=0.1,
)
call("learning.Rolling", lambda: {"direction": [1.0, 0.0, 0.0]})
call("learning.Reach", lambda: {"node": 0, "place": [0.5, 0.0, 0.9], "tolerance": 0.01})
call("learning.Track", lambda: {"node": 0, "path": lambda time: np.zeros((len(time), 3))})
call(
    "Stepper.turn",
    lambda: {"robots": [1], "angles": [0.0, 0.5]},
    steppers,
)
call("Stepper.with_step", lambda: {"step": 0.005}, stepper)
call("Stepper.step", lambda: {"command": 0.98 * rest_length()}, stepper)
call(
    "Stepper.reset",
    lambda: {
        "robots": [1],
        "nodes": nodes(),
        "velocities": STILL,
        "rest_length": rest_length(),
        "parameters": {"stiffness": [90.0]},
    },
    steppers,
)
call("Scene.simulate", lambda: {"progress": False, "start": None}, scene, 0.05)
call(
    "Scene.linearize",
    lambda: {"input": "rest_length", "coordinates": "internal"},
    resting_scene,
    0.2,
)
call(
    "Scene",
    lambda: {
        "model": loaded(),
        "duration": 0.02,
        "nodes": nodes(),
        "velocities": STILL,
        "force_density": gamma(),
        "input": "force_density",
        "faults": [tc.CutString(3, 0.01)],
        "external_force": STILL,
        "prestress": gamma(),
        "integration": tc.Integration(step=1e-3),
        "name": "a",
        "note": "b",
    },
)
call(
    "Integration",
    lambda: {
        "method": "rk4",
        "tolerance": 1e-6,
        "step": 1e-3,
        "output_step": 1e-2,
        "project": True,
        "error": "none",
        "limits": tc.HealthLimits(),
    },
)
call("Scene.equation", lambda: {"derivatives": True}, case)
call("Scene.open_loop", on=scene)
call("load_scene", lambda: {"file": str(SCENE)}, share=0.3)
call("scene.scene_names")
call("scene.scene_template", lambda: {"name": "d_bar"}, share=0.3)

# ---- accuracy ----

call(
    "accuracy.converged_motion",
    lambda: {"scene": case(), "outputs": 5, "report": lambda part: None},
    share=0.05,
)
call("accuracy.ConvergedMotion.summary", on=converged)
call(
    "convergence_order",
    lambda: {
        "scene": case(),
        "method": "rk4",
        "steps": [0.01, 0.005],
        "reference": converged(),
        "outputs": 2,
        "progress": False,
    },
    share=0.1,
)
call("accuracy.ConvergenceOrder.table", on=order)
call(
    "long_run",
    lambda: {
        "scene": case(),
        "method": "rk4",
        "setting": 1e-3,
        "steps": 30,
        "outputs": 30,
        "progress": False,
    },
    share=0.1,
)
call("accuracy.LongRun.of", lambda: {"name": drift().drifts[0].name}, drift)
call("accuracy.LongRun.table", on=drift)
call(
    "predictability",
    lambda: {
        "scene": case(),
        "error": 1e-9,
        "samples": 2,
        "seed": 0,
        "outputs": 10,
        "report": lambda part: None,
    },
    share=0.05,
)
call("accuracy.Predictability.summary", on=predicted)
call(
    "stability_map",
    lambda: {
        "method": "rk4",
        "stiffness": [1e3],
        "mass_ratio": [0.1],
        "steps": 20,
        "progress": False,
    },
    share=0.1,
)
call(
    "stability_map, case",
    lambda: {
        "method": "rk4",
        "stiffness": [1e3],
        "mass_ratio": [0.1],
        "case": lambda stiffness, ratio: case(),
        "steps": 20,
    },
    share=0.1,
)
call("accuracy.StabilityMap.table", on=stable)
call(
    "work_precision",
    lambda: {
        "scene": case(),
        "methods": ["rk4"],
        "settings": {"rk4": [0.01]},
        "peers": [],
        "reference": converged(),
        "repeats": 1,
        "outputs": 5,
        "finest": 1e-6,
        "progress": False,
    },
    share=0.05,
)
call("accuracy.WorkPrecision.of", lambda: {"method": "rk4"}, compared)
call("accuracy.WorkPrecision.is_resolved", lambda: {"row": compared().rows[0]}, compared)
call("accuracy.WorkPrecision.time_at", lambda: {"method": "rk4", "error": 0.1}, compared)
call("accuracy.WorkPrecision.fastest", lambda: {"error": 0.1}, compared)
call("accuracy.WorkPrecision.ratios", lambda: {"errors": [0.1, 0.01], "against": ["rk4"]}, compared)
call("accuracy.WorkPrecision.summary", on=compared)
call("accuracy.WorkPrecision.table", on=compared)
call("accuracy.WorkPrecision.to_markdown", on=compared)
call("accuracy.WorkPrecision.to_csv", lambda: {"path": scratch("rows.csv")}, compared)
call("accuracy.Ratios.table", on=lambda: compared().ratios([0.1], ["rk4"]))
TIMES = np.array([0.01, 0.02])
PEERS = {
    "SciPy": (lambda: {"method": "DOP853"}, (1e-3, 1e-5)),
    "CasADiCVODES": (dict, (1e-3, 1e-5)),
    "CasADiRK": (dict, (1e-2, 1e-3)),
    "MuJoCo": (lambda: {"method": "rk4"}, (1e-2, 1e-3)),
}
for kind, (options, settings) in PEERS.items():
    call(
        f"accuracy.peers.{kind}",
        lambda options=options, settings=settings: dict(**options(), settings=settings),
    )
    if kind != "MuJoCo":
        call(
            f"accuracy.peers.{kind}.prepare",
            lambda settings=settings: {"case": case(), "setting": settings[0], "times": TIMES},
            lambda kind=kind, options=options: getattr(tc.accuracy.peers, kind)(**options()),
            0.2,
        )

# ---- other programs ----


def written(name, text):
    """A file for a function to read."""
    scratch(name).write_text(text)
    return scratch(name)


call(
    "exchange.to_mujoco",
    lambda: {
        "model": elastic(),
        "rest_length": rest_length(),
        "force_density": None,
        "nodes": nodes(),
        "velocities": STILL,
        "external_force": None,
        "actuators": "rest_length",
        "step": 1e-3,
        "integrator": "rk4",
        "actuated": [0, 8],
    },
)
call(
    "exchange.from_mujoco",
    lambda: {
        "source": tc.exchange.to_mujoco(elastic(), rest_length=rest_length()),
        "tolerance": 1e-6,
    },
)
call(
    "exchange.from_csv",
    lambda: {
        "nodes": written("nodes.csv", "x,y\n0,0\n1,0\n1,1\n0,1\n"),
        "members": written("members.csv", "kind,start,end\nbar,0,2\nbar,1,3\nstring,0,1\n"),
    },
)
call("exchange.to_vtk", lambda: {"source": prism(), "path": scratch("prism.vtp")})
call("exchange.to_vtk, run", lambda: {"source": run(), "path": scratch("run.pvd")}, share=0.2)

# ---- robustness ----

call("Uniform", lambda: {"low": 0.0, "high": 1.0, "size": 3})
call("Normal", lambda: {"mean": 0.0, "deviation": 1.0, "size": 3})
call("OneOf", lambda: {"values": [1.0, 2.0], "size": 3})
call("draws", lambda: {"parameters": {"a": tc.Uniform(0.0, 1.0)}, "count": 3, "seed": 0})
call("grid", lambda: {"values": {"a": [1.0, 2.0], "b": [[1.0, 2.0], [3.0, 4.0]]}})
call("robustness.Outcome", lambda: {"success": True, "figures": {"error": 0.1, "force": 2.0}})
call(
    "ClosedLoopCase",
    lambda: {
        "scene": tc.Scene(
            elastic(),
            0.1,
            controller=winch_regulator(),
            rest_length=rest_length(),
            integration=tc.Integration(step=1e-3),
        ),
        "tolerance": 0.01,
        "target": nodes(),
        "success": lambda run: True,
    },
    share=0.5,
)
call(
    "robustness.farthest_node",
    lambda: {
        "plant": plant(),
        "nodes": np.repeat(nodes()[:, :, None], 2, axis=2),
        "target": nodes(),
    },
)
call(
    "sweep",
    lambda: {
        "case": noisy,
        "parameters": drawn(),
        "count": 3,
        "seed": 1,
        "executor": Inline(),
        "in_flight": 1,
        "file": None,
        "progress": False,
    },
    share=0.3,
)
call(
    "robustness.SweepReport.load",
    lambda: {"file": str(swept_file())},
    lambda: tc.robustness.SweepReport,
)
call("robustness.SweepReport.confidence_interval", lambda: {"level": 0.95}, report)
call("robustness.SweepReport.rank_correlation", lambda: {"figure": "value"}, report)
call("robustness.SweepReport.figure", lambda: {"name": "value"}, report)
call("robustness.SweepReport.table", on=report)
call("robustness.SweepReport.summary", on=report)


@cache
def swept_file():
    path = scratch("swept.jsonl")
    tc.sweep(noisy, drawn(), 4, seed=1, executor=Inline(), file=path)
    return path


# ---- files and figures ----

call(
    "generate_c",
    lambda: {
        "controller": regulator(),
        "folder": scratch("c"),
        "name": "regulator",
        "estimator": estimator(),
        "overwrite": True,
    },
    share=0.3,
)
call(
    "deploy.GeneratedController.memory",
    lambda: {"compiler": "cc", "options": ("-O0",), "timeout": 60.0},
    generated,
    0.02,
)
call("deploy.GeneratedController.compile", lambda: {"timeout": 60.0}, generated, 0.02)
call("deploy.CompiledController.another", on=compiled)
call("deploy.CompiledController.twin", on=compiled)
call(
    "plot.structure",
    lambda: {
        "structure": prism(),
        "nodes": nodes(),
        "ax": space(),
        "force_density": gamma(),
        "labels": True,
        "member_labels": False,
        "faint": False,
        "legend": True,
        "actuated": [0, "vertical"],
    },
    share=0.2,
)
call(
    "plot.structure, plane",
    lambda: {
        "structure": tc.library.arm(),
        "nodes": tc.library.arm().nodes,
        "ax": flat(),
        "force_density": np.ones(6),
        "labels": True,
        "member_labels": True,
    },
)
call("plot.structure, run", lambda: {"structure": run(), "time": 0.0, "ax": space()}, share=0.2)
call(
    "plot.Drawing.update",
    lambda: {"nodes": nodes(), "force_density": None, "touching": None},
    drawing,
)
call(
    "plot.animate",
    lambda: {
        "run": run(),
        "path": scratch("run.gif"),
        "fps": 20.0,
        "duration": 0.1,
        "target": nodes(),
        "view": (20.0, -60.0),
        "dpi": 20,
    },
    share=0.03,
)
call("plot.view", lambda: {"shown": prism(), "force_density": gamma()}, share=0.3)
call("plot.View.html", on=view, share=0.03)
call("plot.View.figure", on=view, share=0.1)
call("plot.View.save", lambda: {"path": scratch("view.html")}, view, 0.03)
call("Structure.to_html", lambda: {"path": scratch("page.html")}, prism, 0.03)
call("plant.Modes.to_html", lambda: {"path": scratch("page.html")}, lambda: tc.modes(plant()), 0.03)
call("shape.ShapePath.to_html", lambda: {"path": scratch("page.html")}, short_path, 0.03)
call("simulation.Trajectory.to_html", lambda: {"path": scratch("page.html")}, run, 0.03)
call("plot.convergence_order", lambda: {"result": order(), "ax": flat()}, share=0.2)
call("plot.estimate", lambda: {"run": closed_run(), "strings": [0, 1], "axes": None}, share=0.1)
call("plot.tracking", lambda: {"run": closed_run(), "axes": None}, share=0.1)
call("plot.health", lambda: {"run": run(), "axes": None}, share=0.1)
call("plot.contacts", lambda: {"run": dropped_run(), "axes": None}, share=0.1)
call("plot.motors", lambda: {"run": closed_run(), "axes": None}, share=0.1)
call("plot.struts", lambda: {"run": driven_run(), "axes": None}, share=0.1)
call(
    "plot.history",
    lambda: {
        "time": np.arange(3.0),
        "series": {"a": np.arange(3.0), "b": np.ones(3)},
        "ylabel": "m",
        "ax": flat(),
        "references": {"r": np.zeros(3)},
    },
    share=0.2,
)
call("plot.long_run", lambda: {"result": drift(), "ax": flat()}, share=0.2)
call(
    "plot.mode_shapes",
    lambda: {
        "plant": plant(),
        "modes": tc.modes(plant()),
        "which": [0],
        "scale": 0.2,
        "axes": [space()],
    },
    share=0.1,
)
call("plot.poles", lambda: {"poles": np.array([-1.0, -1 + 1j, -1 - 1j]), "ax": flat()}, share=0.2)
call(
    "plot.save_figure",
    lambda: {"figure": flat().figure, "path": scratch("figure.png"), "width": 89.0},
    share=0.1,
)
call("plot.stability_map", lambda: {"result": stable(), "ax": flat()}, share=0.2)
call(
    "plot.sweep",
    lambda: {
        "report": report(),
        "figure": "value",
        "over": ("delay", "mass[0]"),
        "limit": 1.0,
        "unit": "m",
        "logarithmic": False,
        "axes": None,
    },
    share=0.1,
)
call(
    "plot.trajectory",
    lambda: {
        "run": run(),
        "nodes": [0, 1],
        "directions": "xz",
        "relative_to": "origin",
        "references": {"goal": 1.0},
        "axes": None,
    },
    share=0.1,
)
call("plot.work_precision", lambda: {"result": compared(), "ax": flat()}, share=0.2)


def flat():
    import matplotlib.pyplot as plt

    return plt.subplots()[1]


def space():
    import matplotlib.pyplot as plt

    return plt.figure().add_subplot(projection="3d")
