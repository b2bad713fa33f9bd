"""One of each that docs/developing.rst tells how to add: outside of the package, or in a copy."""

import inspect
import textwrap
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.control import Command, Controller, Fallback
from tenscontrol.dynamics import StringLaw
from tenscontrol.integrate import Integrator, Method, Span, Work
from tests.package_copy import PackageCopy

STILL = np.zeros((3, 6))


# ---- generator ----


def x_frame(width, height, bar_mass=1.0):
    """Two crossed bars with a string along each side of the frame."""
    nodes = np.array(
        [[0, width, 0, width], [0, 0, 0.01 * width, 0.01 * width], [0, height, height, 0]]
    )
    bars, strings = [[0, 1], [2, 3]], [[0, 3], [3, 1], [1, 2], [2, 0]]
    groups = ["horizontal", "vertical", "horizontal", "vertical"]
    return tc.Structure(nodes, bars, strings, bar_mass, string_groups=groups)


def test_generator():
    frame = x_frame(2.0, 1.0)
    np.testing.assert_allclose(frame.string_length(frame.nodes)[1::2], 1.0, rtol=1e-3)
    assert frame.strings_in("horizontal").tolist() == [0, 2]
    run = tc.simulate(tc.Model(frame), 0.1, force_density=1.0)
    assert run.health.bar_length_error < 1e-6


# ---- string law ----


@dataclass(frozen=True, eq=False)
class HardeningStrings(StringLaw):
    """Tension k s + h s² of the stretch s."""

    stiffness: np.ndarray
    hardening: np.ndarray
    damping: np.ndarray = 0.0

    def tension(self, length, rest_length):
        stretch = length - rest_length
        return self.stiffness * stretch + self.hardening * stretch * ca.fabs(stretch)

    def taut_rest_length(self, length, force_density):
        k, h = self.stiffness, self.hardening
        return length - (ca.sqrt(k**2 + 4 * h * length * force_density) - k) / (2 * h)

    def stored_energy(self, length, rest_length):
        stretch = ca.fmax(0, length - rest_length)
        return self.stiffness * stretch**2 / 2 + self.hardening * stretch**3 / 3

    @property
    def largest_force_density(self):
        return np.full(np.shape(self.stiffness), np.inf)


def test_string_law():
    prism = tc.prism()
    law = HardeningStrings(np.array(100.0), np.array(500.0))
    model, rest = tc.Model(prism, strings=law), tc.prestress(prism, force_density=17.3205)
    lengths = tc.to_rest_length(model, prism.nodes, rest.force_density).rest_length
    found = tc.to_force_density(model, prism.nodes, lengths)
    np.testing.assert_allclose(found, rest.force_density, rtol=1e-12)
    stiffer = tc.modes(tc.linearize(model, rest, input="rest_length")).frequency
    linear = tc.Model(prism, strings=tc.LinearStrings(100.0))
    softer = tc.modes(tc.linearize(linear, rest, input="rest_length")).frequency
    assert stiffer[0] > softer[0]
    run = tc.simulate(model, 1.0, rest_length=0.98 * lengths, step=1e-3)
    assert run.health.energy_error < 1e-6


# ---- controller ----


class Relay(Controller):
    """Winds the strings in while the prism is below a height, and lets them out above it."""

    def __init__(self, plant, sample_time, height, swing):
        level = plant.equilibrium_input
        super().__init__(plant, sample_time, level - swing, level + swing)
        self.height, self.swing = height, swing

    def reset(self):
        super().reset()

    def _decide(self, time, state):
        z = self.plant.to_nodes(state[: self.plant.degrees_of_freedom])[2]
        sign = 1.0 if z.max() - z.min() > self.height else -1.0
        return Command(self.plant.equilibrium_input + sign * self.swing)

    def _fall_back(self, status):
        return Command(self.plant.equilibrium_input, status, Fallback.EQUILIBRIUM_HELD)


def test_controller():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    plant = tc.linearize(model, tc.prestress(prism, force_density=17.3205), input="rest_length")
    relay = Relay(plant, 0.01, height=1.0, swing=0.001)
    run = tc.simulate(model, 0.2, controller=relay, step=1e-3)
    assert run.control.status_count == {"ok": 20}
    assert np.abs(run.control.command - plant.equilibrium_input[:, None]).max() < 0.001 + 1e-12
    lost = relay.command(0.0, np.full((3, 6), np.nan), STILL)
    assert lost.fallback is Fallback.EQUILIBRIUM_HELD


# ---- integrator ----


class Heun(Integrator):
    """Heun's method of order 2, in fixed steps that pass over switches."""

    name = "heun"

    def __init__(self, equation, step):
        super().__init__(equation)
        self.step = step

    def advance(self, state, held, duration, outputs, report=None):
        inner = int(np.ceil(duration / outputs / self.step - 1e-9))
        h, states = duration / outputs / inner, []
        for _ in range(outputs):
            for _ in range(inner):
                first = np.array(self._equation.kinked_slope(state, held)).ravel()
                second = np.array(self._equation.kinked_slope(state + h * first, held)).ravel()
                state = state + h / 2 * (first + second)
            states.append(state)
        return Span(np.array(states).T, Work(steps=outputs * inner))


def test_integrator():
    prism = tc.prism()
    model = tc.Model(prism)
    make = lambda equation, step, project=False: Heun(equation, step)  # noqa: E731
    method = Method("heun", ("step",), "order 2, fixed steps", make)
    gamma = tc.prestress(prism, force_density=17.3205).force_density * np.linspace(0.8, 1.2, 9)
    loose = {"limits": tc.HealthLimits(crossings=None)}
    exact = tc.simulate(model, 0.5, force_density=gamma, method="dop853", tolerance=1e-12, **loose)
    errors = [
        np.abs(
            tc.simulate(model, 0.5, force_density=gamma, method=method, step=step, **loose).nodes[
                ..., -1
            ]
            - exact.nodes[..., -1]
        ).max()
        for step in (0.005, 0.0025)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.2)


# ---- QP solver ----


def dense_admm():
    """A QP solver of MPC in NumPy: the alternating direction method of multipliers."""
    from tenscontrol.control.mpc import QPSolution, QPSolver

    class DenseADMM(QPSolver):
        def __init__(self, P, A, tolerance, max_iterations, *, equations=False):
            self.P, self.A = P.toarray(), A.toarray()
            self.tolerance, self.max_iterations = tolerance, max_iterations

        def update(self, A):
            raise NotImplementedError("the matrix of a linear plant stays")

        def solve(self, q, l, u, start=None, deadline=np.inf):  # noqa: E741
            A, status = self.A, tc.control.Status
            rho = np.where(l == u, 100.0, 0.1)  # of equations, and of the rest
            inverse = np.linalg.inv(self.P + A.T * rho @ A)
            z, y = np.clip(0.0, l, u), np.zeros(len(l))
            for k in range(self.max_iterations):
                x = inverse @ (A.T @ (rho * z - y) - q)
                z, last = np.clip(A @ x + y / rho, l, u), z
                y = y + rho * (A @ x - z)
                if max(np.abs(A @ x - z).max(), (rho * np.abs(z - last)).max()) < self.tolerance:
                    return QPSolution(status.OK, x, y, k + 1)
            return QPSolution(status.OUT_OF_ITERATIONS, None, None, self.max_iterations)

        def reset(self):
            pass

    return DenseADMM


def test_qp_solver():
    prism = tc.prism()
    plant = tc.linearize(tc.Model(prism), tc.prestress(prism, force_density=17.3205))
    usual = {"horizon": 5, "sample_time": 0.02, "max_force_density": 33.0}
    nodes = plant.to_nodes([0.05, *np.zeros(8)])
    wanted = tc.MPC(plant, **usual, tolerance=1e-9).command(0.0, nodes, STILL)
    dense = tc.MPC(plant, **usual, solver=dense_admm(), tolerance=1e-9, max_iterations=10**5)
    found = dense.command(0.0, nodes, STILL)
    assert found.status is tc.control.Status.OK
    np.testing.assert_allclose(found.value, wanted.value, atol=1e-4)


# ---- force, in a copy of the package ----

JOINT_FRICTION = '''\
"""Viscous friction in the joints of bars that share nodes."""

from itertools import combinations

import numpy as np

from tenscontrol.dynamics.force import Force, Pass, Read, Write
from tenscontrol.dynamics.kernel import dots, scale_columns
from tenscontrol.validation import number


class JointFriction(Force):
    """Torques −c (ω₁ − ω₂) and c (ω₁ − ω₂) on each two bars b at a node, with ω = b × ḃ/|b|²."""

    argument, unit = "joint_friction", "N m s"
    meaning = "viscous friction between bars that share a node"
    is_velocity_dependent = True

    def __init__(self, coefficient, joints):
        self._coefficient, self._joints = coefficient, joints  # (3, k): a node, and two others

    @classmethod
    def of_argument(cls, structure, value):
        coefficient = 0.0 if value is None else number("joint_friction", value, "N m s")
        others = {}
        for start, end in structure.bars.tolist():
            others.setdefault(start, []).append(end)
            others.setdefault(end, []).append(start)
        joints = [(i, *two) for i, ends in others.items() for two in combinations(ends, 2)]
        if not (coefficient and joints):
            return None
        friction = cls(coefficient, np.array(joints).T)
        # In space a bar does not pass on torques about itself: angular momentum is lost there.
        friction.conserves_momentum = structure.dimension == 2
        return friction

    def passes(self, switched):
        def torque(columns):
            b, rate = ([columns[f"{x}_{k}"] - columns[f"{x}_0"] for k in (1, 2)] for x in "pv")

            def turned(i, arm):  # ω × r = (ḃ (b·r) − b (ḃ·r))/|b|²
                to, off = scale_columns(rate[i], dots(b[i], arm)), dots(rate[i], arm)
                return scale_columns(to - scale_columns(b[i], off), 1 / dots(b[i], b[i]))

            def push(i):
                slip = turned(i, b[i]) - turned(1 - i, b[i])
                return scale_columns(slip, -self._coefficient / dots(b[i], b[i]))

            return push(0), push(1)

        ends = {f"{x}_{k}": Read(x, at) for x in "pv" for k, at in enumerate(self._joints)}
        on = [Write("f", i, self._joints[k], s) for i in (0, 1) for k, s in ((i + 1, 1), (0, -1))]
        return [Pass("joints", self._joints.shape[1], torque, ends, tuple(on), {})]
'''


# ---- force, what it does ----

FOLDING = """
import numpy as np, tenscontrol as tc
mass, length, c = 1.5, 0.8, 0.1
fold = tc.Structure([[0, length, 0], [0, 0, length]], [[0, 1], [0, 2]], [], mass, fixed=[0])
model = tc.Model(fold, joint_friction=c)
speeds = np.array([[0, 0, -0.6], [0, 0.4, 0]]) * length  # 0.4 and 0.6 rad/s
slower = np.exp(-2 * c / (mass * length**2 / 3) * 0.5)
for method, setting in (("dop853", {}), ("rk4", {"step": 5e-3}),
                        ("energy_momentum", {"step": 1e-3}), ("cvodes", {"tolerance": 1e-9})):
    run = tc.simulate(model, 0.5, velocities=speeds, method=method, error="none", **setting)
    b, v = (part[:, 1:, -1] - part[:, :1, -1] for part in (run.nodes, run.velocities))
    spin = (b[0] * v[1] - b[1] * v[0]) / length**2
    assert abs((spin[1] - spin[0]) / 0.2 / slower - 1) < 2e-5, (method, spin, slower)
    assert abs(spin.sum() - 1.0) < 1e-6 and not run.conserves_energy
    assert (np.diff(run.energy) < 0).all()
"""

FORMS = """
from tenscontrol.dynamics.equation import pack_state
from tenscontrol.dynamics.tangent import tangent
tower, gamma = tc.library.class2_tower(2), np.full(12, 10.0)
model = tc.Model(tower, gravity=9.81, joint_friction=0.2)
speeds = np.cos(np.arange(27.0)).reshape(3, 9) * ~np.isin(np.arange(9), tower.fixed)
x, free_rows = pack_state(tower, tower.nodes, speeds), tower.free_rows
slopes = [np.array(model.equation("force_density", form=form).slope(x, gamma, [])).ravel()
          for form in ("flat", "mapped", "loops")]
free = np.array(model.replace(joint_friction=None).dynamics(x, gamma)).ravel()
assert max(np.abs(slopes[0] - other).max() for other in slopes[1:]) < 1e-12
assert np.abs(slopes[0] - free).max() > 0.1
force, (q, v) = model.equation("force_density", form="flat").force, np.split(x, 2)
still, slow = (np.array(force(q, part, gamma, [])).ravel() for part in (0 * v, 1e-6 * v))
found = tangent(model, tower.nodes, "force_density", gamma, model.constant_force).damping
found = found[free_rows][:, free_rows]
assert np.allclose(still - slow, 1e-6 * found @ v, atol=1e-12)
"""


# ---- force, where else it goes ----

ELSEWHERE = """
from pathlib import Path
from tenscontrol.scene.schema import TABLES
run = tc.simulate(model, 0.1, force_density=gamma, step=1e-3)
again = tc.load_run(run.save("run.npz")).model
assert again.arguments["joint_friction"] == model.arguments["joint_friction"] == 0.2
tc.plot.trajectory(run)
tables = ("structure", 'generator = "d_bar"'), ("prestress", "force_density = 10"), (
    "loads", "joint_friction = 0.2"), ("run", "duration = 1")
Path("scene.toml").write_text("".join(f"[{name}]\\n{line}\\n" for name, line in tables))
scene = tc.load_scene("scene.toml")
assert scene.model.arguments["joint_friction"] == 0.2
friction = TABLES["loads"].keys["joint_friction"]
assert friction.unit == "N m s" and friction.meaning.endswith("between bars that share a node")
try:
    tc.exchange.to_mujoco(model, force_density=gamma)
except ValueError as error:
    assert "joint_friction, which is not exported" in str(error)
else:
    raise AssertionError("MuJoCo has no such force")
rest, codes = tc.prestress(scene.structure, force_density=10.0), []
for c in (None, 0.2):
    plant = tc.linearize(scene.model.replace(joint_friction=c), rest)
    assert (np.linalg.eigvals(plant.A).real.min() < -0.01) == (c is not None)
    law = tc.NMPC(plant, horizon=2, sample_time=0.02, max_force_density=20.0)
    code = tc.deploy.generate_c(law, f"code {c}")
    codes.append("".join((code.folder / file).read_text() for file in code.files))
assert len(codes[0]) < len(codes[1])
"""


def test_force_in_the_package(tmp_path):
    copy, model = PackageCopy(tmp_path), "dynamics/model.py"
    copy.add("dynamics/joint_friction.py", JOINT_FRICTION)
    beside, line = "from tenscontrol.dynamics.string_force", "for term in (Contacts,)"
    own = "from tenscontrol.dynamics.joint_friction import JointFriction\n"
    copy.replace("dynamics/forces.py", beside, own + beside)
    copy.replace("dynamics/forces.py", line, "for term in (Contacts, JointFriction)")
    last, others = "Sequence[ContactLaw] | None = None,\n    )", '{"ground": ground}'
    copy.replace(
        model, last, last.replace("    )", "        joint_friction: object = None,\n    )")
    )
    copy.replace(model, others, '{"ground": ground, "joint_friction": joint_friction}')
    copy.run(FOLDING + FORMS + ELSEWHERE)
    assert len(copy.changed) == 3


# ---- string law, in a copy of the package ----


def test_string_law_in_the_package(tmp_path):
    copy, names = PackageCopy(tmp_path), "dynamics/__init__.py"
    head = "from dataclasses import dataclass\nimport casadi as ca\nimport numpy as np\n"
    head += "from tenscontrol.dynamics.string_laws import StringLaw\n\n"
    copy.add("dynamics/hardening.py", head + inspect.getsource(HardeningStrings))
    beside = "from tenscontrol.dynamics.string_laws import"
    own = "from tenscontrol.dynamics.hardening import HardeningStrings\n"
    copy.replace(names, beside, own + beside)
    copy.run("""
import tenscontrol as tc, numpy as np
prism = tc.prism()
law = tc.dynamics.HardeningStrings(np.array(100.0), np.array(500.0))
run = tc.simulate(tc.Model(prism, law), 0.1, rest_length=0.9 * prism.string_length(), step=1e-3)
assert run.health.energy_error < 1e-6
""")
    assert len(copy.changed) == 2


# ---- integrator, in a copy of the package ----


def test_integrator_in_the_package(tmp_path):
    copy, names = PackageCopy(tmp_path), "integrate/methods.py"
    head = "import numpy as np\n"
    head += "from tenscontrol.integrate.integrator import Integrator, Span, Work\n\n"
    copy.add("integrate/heun.py", head + inspect.getsource(Heun))
    beside = "from tenscontrol.integrate.integrator import"
    copy.replace(names, beside, "from tenscontrol.integrate.heun import Heun\n" + beside)
    own = "make = lambda equation, step, **_: Heun(equation, step)\n_ALL = (\n"
    own += '    Method("heun", ("step",), "order 2", make),\n'
    copy.replace(names, "_ALL = (\n", own)
    copy.run("""
import tenscontrol as tc
run = tc.simulate(tc.Model(tc.prism()), 0.1, force_density=1.0, method="heun", step=1e-3)
assert run.method == "heun"
""")
    assert len(copy.changed) == 2


# ---- within a copy of the package ----


def run_changed(folder, changes, program):
    """Run a program with a copy of the package in which files are changed, or new.

    ``changes`` has for each file of the package the text before which another is put, and that
    text; for a new file an empty one, and its text.
    """
    copy = PackageCopy(folder, "docs/_ext", "docs/api")
    for name, pairs in changes.items():
        for before, added in pairs:
            if before:
                copy.replace(name, before, added + before)
            else:
                copy.add(name, added)
    copy.run(textwrap.dedent(BEGIN) + textwrap.dedent(program))


BEGIN = """
    import sys
    from pathlib import Path
    import numpy as np
    import tenscontrol as tc
    sys.path.insert(0, str(Path.cwd() / 'docs' / '_ext'))
    import folder, scene_keys

    COMMANDS = '[controller]\\ninput = "rest_length"\\nsample_time = 0.02\\n'

    def scene(controller, structure='generator = "prism"'):
        Path("scene.toml").write_text(f'''
            [structure]
            {structure}
            [strings]
            law = "linear"
            stiffness = 1000.0
            [prestress]
            min_force_density = 10.0
            {controller}
            [run]
            duration = 0.04
            output_step = 0.02
            ''')
        return tc.load_scene("scene.toml")

    def pages(name):
        page = Path("docs/api", f"{name}.rst").read_text("utf-8")
        return list(folder.exported(page, f"tenscontrol.{name}", ""))

    assert tc.__file__.startswith(str(Path.cwd()))
"""


def test_an_option_of_mpc_is_declared_once(tmp_path):
    changes = {
        "control/mpc/settings.py": [
            (
                "    tracked : array_like, shape (p, d n), optional\n",
                "    effort : float\n        Factor of the weight of the input, m, positive.\n",
            ),
            (
                "    tracked: object = field(",
                "    effort: float = field(default=1.0, metadata=checked(\n"
                "        validation.positive_number, 'm'))\n",
            ),
            (
                "    if not nonlinear or plant.model.contacts is None:\n",
                "    input_weight = settings.effort * input_weight\n",
            ),
        ]
    }
    assert len(changes) == 1
    program = """
        MPC = COMMANDS + 'kind = "mpc"\\nhorizon = 5\\n'
        plain, dear = scene(MPC).controller, scene(MPC + "effort = 100.0").controller
        assert (plain.law.settings.effort, dear.law.settings.effort) == (1.0, 100.0)
        again = tc.MPC(plain.plant, horizon=5, sample_time=0.02, effort=100.0)
        pushed = plain.plant.to_nodes(np.full(9, 0.001)), np.zeros((3, 6))
        moves = [np.abs(each.command(0.0, *pushed).value - plain.plant.equilibrium_input).max()
                 for each in (plain, dear, again)]
        assert moves[0] > 1.01 * moves[1] == 1.01 * moves[2], moves
        for wrong, words in {
            "efort = 1.0": "has no key 'efort'; did you mean 'effort'?",
            "effort = 'big'": "effort is the text 'big', expected a number in m",
            "effort = -1.0": "scene.toml:14: in [controller] with kind = 'mpc', effort is -1.0",
        }.items():
            try:
                scene(MPC + wrong)
            except tc.scene.SceneError as error:
                assert words in str(error), error
            else:
                raise AssertionError(wrong)
        (line,) = [each for each in tc.scene.scene_template("arm").splitlines() if "effort" in each]
        assert line.split("  ")[0] == "# effort = 1.0"
        assert line.endswith("  # m: factor of the weight of the input"), line
        entry = "effort : float\\n    Factor of the weight of the input, m"
        assert entry in tc.MPC.__doc__ and entry in tc.NMPC.__doc__
        listed = "factor of the weight of the input (default ``1.0``)"
        assert listed in scene_keys.table("controller")
    """
    run_changed(tmp_path, changes, program)


GENERATOR = '''"""Frames."""

import numpy as np

from tenscontrol.structure import Structure


def x_frame(reach: float = 2.0, tallness: float = 1.0) -> Structure:
    """Return two crossed bars with a string along each side of the frame.

    Parameters
    ----------
    reach : float
        Length of the strings along x, m.
    tallness : float
        Length of the strings along z, m.
    """
    x, z = np.array([0, reach, 0, reach]), np.array([0, tallness, tallness, 0])
    sides = [[0, 3], [3, 1], [1, 2], [2, 0]]
    return Structure([x, z], [[0, 1], [2, 3]], sides, 1.0, fixed=[0, 3])
'''


def test_a_generator_of_the_library_is_two_files(tmp_path):
    changes = {
        "library/frames.py": [("", GENERATOR)],
        "library/__init__.py": [
            (
                "from tenscontrol.structure import",
                "from tenscontrol.library.frames import x_frame\n",
            ),
            ('    "wheel",\n', '    "x_frame",\n'),
        ],
    }
    assert len(changes) == 2
    program = """
        found = scene("", 'generator = "x_frame"\\nreach = 3.0').structure
        assert np.allclose(np.ptp(found.nodes, axis=1), [3.0, 1.0])
        text = tc.scene.scene_template("x_frame")
        assert "  # m: length of the strings along x\\n" in text
        Path("new.toml").write_text(text)
        assert tc.load_scene("new.toml").controller is not None
        assert tc.scene.scene_names()["x_frame"].startswith("Two crossed bars")
        assert "tenscontrol.library.x_frame" in pages("library")
    """
    run_changed(tmp_path, changes, program)


CONTROLLER = '''"""Relay control."""

import numpy as np

from tenscontrol.control.command import Command, Fallback
from tenscontrol.control.controller import Controller
from tenscontrol.plant import LinearPlant
from tenscontrol.status import Status
from tenscontrol.validation import FloatArray, positive_number


class TwoPointRelay(Controller):
    """Winds the strings in below a height, and lets them out above it.

    Parameters
    ----------
    plant : LinearPlant
    sample_time : float
        Time between two commands, s.
    setpoint : float
        Height of the relay, m.
    swing : float
        Change of the rest lengths, m.
    """

    def __init__(
        self, plant: LinearPlant, sample_time: float, setpoint: float, swing: float = 1e-3
    ) -> None:
        swing = positive_number("swing", swing, "m")
        level = plant.equilibrium_input
        super().__init__(plant, sample_time, level - swing, level + swing)
        self.setpoint, self.swing = setpoint, swing

    def _decide(self, time: float, state: FloatArray) -> Command:
        height = np.ptp(self.plant.to_nodes(state[: self.plant.degrees_of_freedom])[2])
        sign = 1.0 if height > self.setpoint else -1.0
        return Command(self.plant.equilibrium_input + sign * self.swing)

    def _fall_back(self, status: Status) -> Command:
        return Command(self.plant.equilibrium_input, status, Fallback.EQUILIBRIUM_HELD)
'''


def test_a_controller_is_two_files(tmp_path):
    changes = {
        "control/relay.py": [("", CONTROLLER)],
        "control/__init__.py": [
            (
                "from tenscontrol.control.lqr import",
                "from tenscontrol.control.relay import TwoPointRelay\n",
            ),
            ('    "clearance",\n', '    "TwoPointRelay",\n'),
        ],
    }
    assert len(changes) == 2
    program = """
        RELAY = COMMANDS + 'kind = "two_point_relay"\\n'
        run = scene(RELAY + "setpoint = 1.0\\nswing = 0.002").simulate()
        assert run.control.status_count == {"ok": 2}
        rest = scene(RELAY + "setpoint = 1.0").controller.plant.equilibrium_input
        assert np.allclose(np.abs(run.control.command - rest[:, None]), 0.002)
        try:
            scene(RELAY + "swing = 0.002")
        except tc.scene.SceneError as error:
            assert "lacks the key setpoint: a number in m" in str(error), error
        else:
            raise AssertionError("setpoint is missing")
        assert '"two_point_relay"' in tc.scene.scene_template("arm")
        assert "height of the relay" in scene_keys.table("controller")
        assert "tenscontrol.control.TwoPointRelay" in pages("control")
    """
    run_changed(tmp_path, changes, program)


# ---- as the page says ----


def test_each_takes_less_than_sixty_lines():
    text = Path(__file__).read_text(encoding="utf-8").partition("\n# ---- within a copy")[0]
    _, *parts = text.split("\n# ---- ")
    lengths = {part.partition(" ----")[0]: len(part.strip().splitlines()) for part in parts}
    assert set(lengths) >= {"generator", "string law", "controller", "integrator", "QP solver"}
    assert max(lengths.values()) < 60, lengths
