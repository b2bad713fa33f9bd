"""The rules of the house: what may be imported where, what is documented, what never changes."""

import ast
import builtins
import dataclasses
import importlib.metadata
import importlib.util
import inspect
import re
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import cache, cached_property
from pathlib import Path

import numpy as np
import pytest

import tenscontrol as tc

PACKAGE = Path(tc.__file__).parent
PROJECT = Path(__file__).parent.parent
SOURCES = sorted(PACKAGE.rglob("*.py"))


def place(path):
    """A file as it is called within the package, for messages."""
    return path.relative_to(PACKAGE).as_posix()


@cache
def tree(path):
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


# ---- what an import costs ----


def loaded_by(program):
    """Names of all modules that a program of its own has loaded at its end."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"{program}\nimport sys; print(*sys.modules)"],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return set(done.stdout.split())


def test_importing_the_package_loads_no_library_but_numpy():
    modules = loaded_by("import tenscontrol")
    assert not modules & {"matplotlib", "control", "osqp", "scipy", "tqdm", "casadi"}


def test_evaluating_a_model_loads_no_controller_and_no_plots():
    modules = loaded_by(
        "import numpy as np, tenscontrol as tc\n"
        "prism = tc.prism()\n"
        "tc.Model(prism).acceleration(prism.nodes, np.zeros((3, 6)), np.ones(9))"
    )
    assert "casadi" in modules
    assert not modules & {"matplotlib", "control", "osqp"}


def test_naming_everything_public_loads_no_controller_and_no_plots():
    modules = loaded_by("import tenscontrol as tc\n[getattr(tc, name) for name in tc.__all__]")
    assert not modules & {"matplotlib", "control", "osqp", "tqdm"}


# ---- who imports whom ----

# Folder: what it may import of the package, beside itself and ``validation``.
MAY_IMPORT = {
    "structure": set(),
    "statics": {"structure"},
    "dynamics": {"structure"},
    "integrate": {"dynamics", "structure"},
    "analysis": {"dynamics", "statics", "structure"},
    "control": {"actuation", "analysis", "dynamics", "statics", "structure"},
    "estimation": {"control.path", "control.reduced_dynamics", "control.sampled", "control.strings"}
    | {"analysis", "actuation", "dynamics", "structure"},
    "actuation": {"dynamics", "structure"},
    "deploy": {"control", "analysis", "dynamics"},
    "simulation": {"integrate", "actuation", "dynamics", "structure", "control.controller"}
    | {"estimation"},
    "accuracy": {"simulation", "integrate", "actuation", "analysis", "dynamics", "statics"}
    | {"structure", "scene"},
    "shape": {"control.reference", "actuation", "analysis", "dynamics", "statics", "structure"},
    "scene": {"simulation", "integrate", "control", "actuation", "analysis", "dynamics", "statics"}
    | {"structure", "shape", "estimation"},
    "robustness": {"simulation", "estimation", "control", "actuation", "analysis", "dynamics"}
    | {"shape", "statics", "structure"}
    | {"accuracy.tables", "_version"},
    "plot": None,  # everything
}

# Library: the only places that may import it, and whether only functions may.
LIBRARIES = {
    "numpy": (lambda file: True, False),
    "scipy": (lambda file: True, False),
    "casadi": (lambda file: not file.startswith(("structure/", "statics/")), False),
    "control": (lambda file: file.startswith(("analysis/", "control/", "estimation/")), True),
    "osqp": (lambda file: file.startswith("control/"), True),
    "matplotlib": (lambda file: file.startswith("plot/"), False),
    "mpl_toolkits": (lambda file: file.startswith("plot/"), False),
    "mujoco": (lambda file: file.startswith("accuracy/peers/"), True),
    "PIL": (lambda file: file.startswith("plot/"), False),
    "tqdm": (lambda file: file in {"simulation/progress.py", "cli.py", "demo.py"}, True),
}

# Folders in which SciPy is for functions only.
NO_SCIPY_AT_THE_TOP = ("structure/", "dynamics/")


@dataclasses.dataclass(frozen=True)
class Import:
    file: str
    line: int
    module: str
    names: tuple[str, ...]  # empty for ``import module``
    inside_function: bool
    for_types_only: bool

    def __str__(self):
        return f"{self.file}:{self.line} imports {self.module}"


class _Imports(ast.NodeVisitor):
    def __init__(self, path):
        self._path = path
        self._functions = self._types = 0
        self.found = []

    def _add(self, node, module, names):
        self.found.append(
            Import(
                place(self._path),
                node.lineno,
                module,
                tuple(names),
                self._functions > 0,
                self._types > 0,
            )
        )

    def visit_Import(self, node):
        for alias in node.names:
            self._add(node, alias.name, ())

    def visit_ImportFrom(self, node):
        module = node.module or ""
        if node.level:
            here = ["tenscontrol", *self._path.relative_to(PACKAGE).parent.parts]
            above = here[: len(here) - node.level + 1]
            module = ".".join([*above, *filter(None, [module])])
        self._add(node, module, [alias.name for alias in node.names])

    def visit_FunctionDef(self, node):
        self._functions += 1
        self.generic_visit(node)
        self._functions -= 1

    def visit_If(self, node):
        is_guard = ast.unparse(node.test) in {"TYPE_CHECKING", "typing.TYPE_CHECKING"}
        self._types += is_guard
        for child in node.body:
            self.visit(child)
        self._types -= is_guard
        for child in node.orelse:
            self.visit(child)


@cache
def imports():
    """Every import of the package, also those within functions."""
    found = []
    for path in SOURCES:
        visitor = _Imports(path)
        visitor.visit(tree(path))
        found += visitor.found
    return found


def test_the_walk_sees_imports_of_every_kind():
    found = imports()
    assert any(item.inside_function for item in found)
    assert any(item.for_types_only for item in found)
    assert any(item.module == "tenscontrol.structure" for item in found)
    assert len({item.file for item in found}) > 20


def test_every_folder_has_its_rule():
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders <= set(MAY_IMPORT)


def _is_allowed(item, folder):
    if MAY_IMPORT[folder] is None:
        return True
    allowed = {f"tenscontrol.{name}" for name in {*MAY_IMPORT[folder], folder, "validation"}}

    def inside(module):
        return any(module == name or module.startswith(f"{name}.") for name in allowed)

    if inside(item.module):
        return True
    # ``from tenscontrol.control import controller``
    return bool(item.names) and all(inside(f"{item.module}.{name}") for name in item.names)


def test_folders_import_only_what_lies_before_them():
    wrong = []
    for item in imports():
        if item.module.split(".")[0] != "tenscontrol":
            continue
        folder = item.file.split("/")[0]
        if folder in MAY_IMPORT and not _is_allowed(item, folder):
            wrong.append(str(item))
    assert wrong == []


def test_the_base_of_the_package_imports_nothing_of_it():
    wrong = [
        str(item)
        for item in imports()
        if item.file in {"validation.py", "_version.py"}
        and item.module.split(".")[0] == "tenscontrol"
    ]
    lazy = [
        str(item)
        for item in imports()
        if item.file == "__init__.py"
        and not (item.for_types_only or item.inside_function)
        and item.module.startswith("tenscontrol")
        and item.module != "tenscontrol._version"
    ]
    assert wrong + lazy == []


def _library_fault(item):
    """What is wrong with an import of something from outside the package, or None."""
    library = item.module.split(".")[0]
    if library in sys.stdlib_module_names or library == "tenscontrol":
        return None
    if library not in LIBRARIES:
        return "which is no dependency"
    is_home, only_in_functions = LIBRARIES[library]
    if not is_home(item.file):
        return "away from where it belongs"
    if library == "scipy":
        only_in_functions = item.file.startswith(NO_SCIPY_AT_THE_TOP)
    if only_in_functions and not (item.inside_function or item.for_types_only):
        return "outside of a function"
    return None


def test_libraries_are_imported_only_where_they_belong():
    faults = [(item, _library_fault(item)) for item in imports()]
    assert [f"{item} {fault}" for item, fault in faults if fault] == []


# ---- how files are written ----


def test_no_file_is_too_long():
    lengths = {place(path): len(path.read_text("utf-8").splitlines()) for path in SOURCES}
    assert {file: count for file, count in lengths.items() if count > 600} == {}


def test_assertions_say_why_they_hold():
    # A user's input is never checked by assert; what is left states what was checked elsewhere.
    bare = []
    for path in SOURCES:
        lines = path.read_text("utf-8").splitlines()
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Assert):
                last = lines[node.end_lineno - 1]
                if not re.search(r"\S\s+#\s*\S", last[node.end_col_offset - 1 :]):
                    bare.append(f"{place(path)}:{node.lineno}")
    assert bare == []


def test_no_folder_reads_private_names_of_another():
    own, reads = set(), []
    for path in SOURCES:
        folder = path.relative_to(PACKAGE).parts[0]
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.FunctionDef):
                own.add((folder, node.name))
            elif isinstance(node, ast.Attribute) and re.match("_[^_]", node.attr):
                if ast.unparse(node.value) not in {"self", "cls", "super()"}:
                    reads.append((folder, node.attr, f"{place(path)}:{node.lineno}"))
                elif isinstance(node.ctx, ast.Store):
                    own.add((folder, node.attr))
    assert reads
    assert [item for item in reads if item[:2] not in own] == []


# The only places that may catch any error, each by one handler that keeps what it caught.
CATCH_ANY = {"robustness/pool.py": 1}  # a run that fails is data of a sweep


def test_no_error_is_caught_unseen():
    wide = {"Exception", "BaseException", "Warning"}
    caught = []
    for path in SOURCES:
        for node in ast.walk(tree(path)):
            if not isinstance(node, ast.ExceptHandler):
                continue
            kinds = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
            names = {None if kind is None else ast.unparse(kind).split(".")[-1] for kind in kinds}
            is_silent = all(isinstance(line, ast.Pass | ast.Continue) for line in node.body)
            if names & {None, *wide} or is_silent:
                caught.append((place(path), node.lineno))
    counts = Counter(file for file, _ in caught)
    assert counts == CATCH_ANY, caught


def test_no_star_imports():
    assert [str(item) for item in imports() if "*" in item.names] == []


_MUTABLE = (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp)
_MUTABLE_CALLS = {"list", "dict", "set", "bytearray", "defaultdict", "deque", "Counter"}
_MUTABLE_CALLS |= {"array", "zeros", "ones", "empty", "full", "eye", "arange", "linspace"}
_MUTATING = {"append", "extend", "insert", "add", "update", "setdefault", "pop", "popitem"}
_MUTATING |= {"remove", "discard", "clear", "sort", "reverse", "setflags"}
_GLOBAL_SETTINGS = re.compile(
    r"\b(seterr|set_printoptions|simplefilter|filterwarnings|basicConfig|use|switch_backend"
    r"|setrecursionlimit|set_defaults)$|\brcParams(\.\w+|Default)?$|\benviron\b"
)


def _is_mutable(value):
    if isinstance(value, _MUTABLE):
        return True
    if isinstance(value, ast.Call):
        return ast.unparse(value.func).split(".")[-1] in _MUTABLE_CALLS
    return False


def _module_containers(path):
    """Names bound at module level to something that can change, with their lines."""
    names = {}
    for node in tree(path).body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        if isinstance(node, ast.AnnAssign) and node.value is not None:
            targets = [node.target]
        for target in targets:
            if isinstance(target, ast.Name) and _is_mutable(node.value):
                names[target.id] = node.lineno
    return names


def _root(node):
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


def test_modules_hold_no_settings_that_change():
    faults = []
    for path in SOURCES:
        containers = _module_containers(path)
        faults += [
            f"{place(path)}:{line} {name} is public and mutable"
            for name, line in containers.items()
            if not name.startswith("_")
        ]
        for node in ast.walk(tree(path)):
            where = f"{place(path)}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Global):
                faults.append(f"{where} global {', '.join(node.names)}")
            changed = []
            if isinstance(node, ast.Assign | ast.Delete):
                changed = [target for target in node.targets if not isinstance(target, ast.Name)]
            elif isinstance(node, ast.AugAssign):
                changed = [node.target]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                if node.func.attr in _MUTATING:
                    changed = [node.func.value]
                if _GLOBAL_SETTINGS.search(ast.unparse(node.func)):
                    faults.append(f"{where} {ast.unparse(node.func)} changes settings of others")
            for target in changed:
                if _root(target) in containers or _GLOBAL_SETTINGS.search(
                    ast.unparse(target.value if isinstance(target, ast.Subscript) else target)
                ):
                    faults.append(f"{where} changes {ast.unparse(target)}")
    assert faults == []


# ---- what is documented ----

HAS_PLOT = importlib.util.find_spec("tenscontrol.plot") is not None


@cache
def public():
    """Every public function and class by the name that users know."""
    names = {name: getattr(tc, name) for name in tc.__all__ if name != "__version__"}
    if HAS_PLOT:
        plot = importlib.import_module("tenscontrol.plot")
        names |= {f"plot.{name}": getattr(plot, name) for name in plot.__all__}
    return names


def public_functions():
    return {name: value for name, value in public().items() if not inspect.isclass(value)}


def public_classes():
    return {name: value for name, value in public().items() if inspect.isclass(value)}


@cache
def members():
    """Public methods and properties of public classes, as ``Class.name: (class, member)``.

    What a class inherits from another public class is listed there only.
    """
    classes, found = public_classes(), {}
    for class_name, cls in classes.items():
        for base in cls.__mro__:
            inherits = base is not cls and base in classes.values()
            if inherits or not base.__module__.startswith("tenscontrol"):
                continue
            for name, member in vars(base).items():
                is_member = inspect.isfunction(member) or isinstance(
                    member, property | cached_property | classmethod | staticmethod
                )
                if is_member and not name.startswith("_"):
                    found.setdefault(f"{class_name}.{name}", (cls, member))
    return found


def documented(docstring, section):
    """Names of the entries of a numpydoc section; combined entries count for each name."""
    lines = inspect.cleandoc(docstring or "").splitlines()
    names, inside = [], False
    for i, line in enumerate(lines):
        rule = lines[i + 1] if i + 1 < len(lines) else ""
        if re.fullmatch(r"-{3,}", rule.strip()):
            inside = line.strip() == section
        elif inside and line and not line[0].isspace() and not re.fullmatch(r"-{3,}", line):
            names += [name.strip().lstrip("*") for name in line.split(" : ")[0].split(",")]
    return names


def has_section(docstring, section):
    pattern = rf"^{section}\n-{{{len(section)}}}$"
    return re.search(pattern, inspect.cleandoc(docstring or ""), re.MULTILINE) is not None


def parameters(function):
    """Names of the parameters of a function, method or class, ``self`` left out."""
    names = [name for name in inspect.signature(function).parameters if name != "_"]
    return [name for name in names if name not in {"self", "cls"}]


def _parameter_faults(function, docstring):
    wanted, found = set(parameters(function)), documented(docstring, "Parameters")
    faults = [f"does not document {name}" for name in parameters(function) if name not in found]
    faults += [f"documents {name}, which it does not take" for name in found if name not in wanted]
    faults += [f"documents {name} twice" for name in set(found) if found.count(name) > 1]
    return faults


def _docstrings_that_hold(cls, member):
    """The docstring of a method, those of the methods it overrides, and the one it refers to."""
    own = inspect.getdoc(member) or ""
    texts = [own]
    for base in cls.__mro__:
        other = vars(base).get(member.__name__)
        if other is not None and other is not member:
            texts.append(inspect.getdoc(other) or "")
    for path in re.findall(r"(?:[Ss]ee|[Aa]s) :meth:`~?\.?([\w.]+)`", own):
        target = tc if "." in path else cls
        for part in path.split("."):
            target = getattr(target, part)
        texts.append(inspect.getdoc(target) or "")
    return texts


def test_there_is_something_to_walk():
    assert len(public_functions()) > 12
    assert len(public_classes()) > 15
    assert "Structure.bar_length" in members()
    assert "Coordinates.measure" in members()
    assert documented(tc.dynamics.Coordinates.measure.__doc__, "Parameters") == [
        "nodes",
        "velocities",
    ]
    assert documented(tc.simulate.__doc__, "Parameters") == parameters(tc.simulate)


def test_every_public_name_has_a_docstring():
    # A dataclass without a docstring gets its signature for one.
    silent = [
        name
        for name, value in public().items()
        if not inspect.getdoc(value) or (inspect.getdoc(value) or "").startswith(name + "(")
    ]
    silent += [name for name, (_, member) in members().items() if not inspect.getdoc(member)]
    assert silent == []


@pytest.mark.parametrize("name", public_functions())
def test_functions_document_every_parameter(name):
    function = public()[name]
    assert _parameter_faults(function, function.__doc__) == []


@pytest.mark.parametrize("name", public_functions())
def test_functions_have_an_example(name):
    assert has_section(public()[name].__doc__, "Examples")
    assert ">>> " in public()[name].__doc__


@pytest.mark.parametrize(
    "name", [name for name, (_, member) in members().items() if inspect.isfunction(member)]
)
def test_methods_document_every_parameter(name):
    cls, method = members()[name]
    faults = [_parameter_faults(method, text) for text in _docstrings_that_hold(cls, method)]
    assert min(faults, key=len) == []


# Classes that users construct; the others are made by functions, and list their attributes.
CONSTRUCTED = {
    "Case",
    "ClosedLoopCase",
    "CutString",
    "HealthLimits",
    "LostMeasurement",
    "StuckWinch",
    "ElasticStrings",
    "Height",
    "NMPC",
    "OutputLimit",
    "LinearStrings",
    "MPC",
    "Model",
    "NodesAt",
    "Normal",
    "OneOf",
    "OperatingPoint",
    "Outcome",
    "PointAt",
    "Reference",
    "RotationalSymmetry",
    "GainSchedule",
    "Sensors",
    "FeedbackLinearization",
    "Structure",
    "Twist",
    "Uniform",
    "Winches",
}


def test_classes_that_users_construct_say_how():
    takers = {
        name
        for name, cls in public_classes().items()
        if has_section(cls.__doc__, "Parameters") and not inspect.isabstract(cls)
    }
    assert takers == CONSTRUCTED & set(public_classes())


@pytest.mark.parametrize(
    "name",
    [name for name, cls in public_classes().items() if has_section(cls.__doc__, "Parameters")],
)
def test_constructors_document_every_parameter(name):
    cls = public()[name]
    assert _parameter_faults(cls, cls.__doc__) == []


@pytest.mark.parametrize("name", sorted(CONSTRUCTED))
def test_classes_that_users_construct_have_an_example(name):
    assert has_section(public()[name].__doc__, "Examples")
    assert ">>> " in public()[name].__doc__


def _attributes(cls):
    """Names of the public attributes of a class: fields, properties, and what __init__ sets."""
    names = {field.name for field in dataclasses.fields(cls)} if _is_data(cls) else set()
    for base in cls.__mro__:
        names |= set(vars(base)) | set(vars(base).get("__annotations__", {}))
        if base.__module__.startswith("tenscontrol"):
            source = inspect.cleandoc("\n" + inspect.getsource(base))
            names |= {
                node.attr
                for node in ast.walk(ast.parse(source))
                if isinstance(node, ast.Attribute)
                and isinstance(node.ctx, ast.Store)
                and ast.unparse(node.value) == "self"
            }
    return names


def _is_data(cls):
    return dataclasses.is_dataclass(cls)


@pytest.mark.parametrize("name", public_classes())
def test_classes_document_what_they_hold(name):
    cls = public()[name]
    listed = documented(cls.__doc__, "Attributes")
    assert [entry for entry in listed if entry not in _attributes(cls)] == []
    if _is_data(cls) and not has_section(cls.__doc__, "Parameters"):
        fields = [field.name for field in dataclasses.fields(cls)]
        missing = {field for field in fields if not field.startswith("_")} - set(listed)
        assert missing == set()


# ---- values do not change ----


@pytest.fixture(scope="module")
def values(tmp_path_factory):
    """One value of each public dataclass, by class name."""
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0, damping=0.1))
    rest = tc.prestress(prism, force_density=17.3205)
    plant = tc.linearize(model, rest)
    regulator = tc.lqr(plant, Q=1.0, R=1e-3, sample_time=0.01, max_force_density=50.0)
    mpc = tc.MPC(plant, horizon=3, sample_time=0.01, max_force_density=50.0)
    still = np.zeros((3, 6))
    sensors = tc.Sensors(structure=prism, string_length=0.001, nodes=[0, 2], node_position=0.01)
    held = tc.linearize(model, rest, input="rest_length")
    estimator = tc.kalman(held, sensors, sample_time=0.01)
    winches = tc.Winches(rate=0.5, shortest=np.full(9, 0.1), longest=2.0)
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
    height = tc.Height(0.9, top=[0, 1, 2], bottom=[3, 4, 5])
    target = tc.shape_target(model, height, force_density=17.3205)
    found = [
        height,
        tc.Twist(0.1, top=[0, 1, 2], bottom=[3, 4, 5]),
        tc.NodesAt([0], np.zeros((3, 1))),
        tc.PointAt([0, 1], np.zeros(3)),
        tc.RotationalSymmetry([[0, 1, 2], [3, 4, 5]]),
        target,
        target.demands[0],
        tc.shape_path(model, rest, target, duration=1.0, step=0.2),
        prism,
        rest,
        rest.stability,
        plant,
        plant.coordinates,
        tc.modes(plant),
        tc.controllability(plant),
        run,
        run.control,
        run.control.estimate,
        sensors,
        estimator.update(None),
        estimator.statistics,
        run.choice,
        run.work,
        run.health,
        tc.HealthLimits(),
        tc.CutString(string=3, time=1.0),
        tc.StuckWinch(string=5, time=0.8, until=1.5),
        tc.LostMeasurement(time=0.5, until=0.7),
        start,
        winches,
        winches.move(start.rest_length, start.rest_length, 0.01),
        model.strings,
        tc.ElasticStrings(axial_rigidity=np.full(9, 100.0)),
        tc.OperatingPoint(prism.nodes.copy(), rest.force_density.copy(), still),
        regulator.command(0.0, prism.nodes, still),
        tc.Reference([0.0], prism.nodes[:, :, None], rest.force_density[:, None]),
        mpc.statistics,
        tc.generate_c(regulator, tmp_path_factory.mktemp("code")),
        tc.NMPC(plant, horizon=3, sample_time=0.01, max_force_density=50.0).statistics,
        tc.FeedbackLinearization(
            plant, reference=None, sample_time=0.01, max_force_density=50.0, frequency=1.0
        ).statistics,
        tc.OutputLimit(np.ones((1, 18)), np.zeros(1), np.ones(1)),
        tc.control.held_loop(plant, regulator.gain, sample_time=0.01),
        tc.load_scene(PROJECT / "examples" / "scenes" / "prism_free.toml"),
    ]
    case = tc.Case(model, 0.05, input="force_density", value=rest.force_density)
    compared = tc.work_precision(case, ["rk4"], {"rk4": [0.01]}, repeats=1, outputs=5)
    drift = tc.long_run(case, "rk4", 1e-3, steps=30, outputs=30)
    found += [
        case,
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
    loop = tc.ClosedLoopCase(
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


DATA = [
    name
    for name, cls in public_classes().items()
    if _is_data(cls) and not name.startswith("plot.") and not inspect.isabstract(cls)
]


def test_every_dataclass_is_frozen():
    data = [cls for cls in public_classes().values() if _is_data(cls)]
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
        "LinearStrings": {"stiffness": np.ones(9), "damping": np.ones(9)},
        "ElasticStrings": {"axial_rigidity": np.ones(9), "damping": np.ones(9)},
        "Case": {
            "model": tc.Model(prism),
            "duration": 1.0,
            "nodes": prism.nodes.copy(),
            "velocities": np.zeros((3, 6)),
            "held": "force_density",
            "value": np.ones(9),
        },
        "OperatingPoint": point | {"external_force": np.ones((3, 6))},
        "Winches": {"rate": np.ones(9), "shortest": np.ones(9), "longest": np.ones(9)},
        "NodesAt": {"nodes": np.arange(2), "positions": np.ones((3, 2))},
        "PointAt": {"nodes": np.arange(2), "position": np.ones(3), "weights": np.ones(2)},
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


# ---- what is handed out ----


def _texts():
    """Text files of the project, without what tools have made."""
    made = {"__pycache__", "_build", "auto_examples", "generated", "gen_modules", "build", "dist"}
    paths = [path for pattern in ("*.md", "*.toml", "*.cff") for path in PROJECT.glob(pattern)]
    for folder in ("tenscontrol", "tests", "docs", "examples", ".ci", ".github"):
        paths += [path for path in (PROJECT / folder).rglob("*") if path.is_file()]
    for path in sorted(set(paths)):
        if made & set(path.relative_to(PROJECT).parts):
            continue
        try:
            yield path, path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue  # a picture


def test_no_text_speaks_of_the_place_it_was_written_in():
    # Put together here, so that this file does not speak of it either.
    private = re.compile(
        "|".join([r"(?<!\w)/" + r"work\b(?!-)", r"\.\./" + "shared", "shared" + "/d"])
    )
    seen, mentions = 0, []
    for path, text in _texts():
        seen += 1
        mentions += [
            f"{path.relative_to(PROJECT)}: {match.group()}" for match in private.finditer(text)
        ]
    assert seen > 30
    assert mentions == []


def test_the_version_is_one():
    assert importlib.metadata.version("tenscontrol") == tc.__version__


def test_the_changelog_has_the_version():
    text = (PROJECT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(rf"^#+ .*\b{re.escape(tc.__version__)}\b", text, re.MULTILINE)


def test_the_citation_has_the_version():
    text = (PROJECT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(rf"^version: [\"']?{re.escape(tc.__version__)}[\"']?$", text, re.MULTILINE)


def test_names_are_listed_once_and_hide_no_builtin():
    names = [name for name in tc.__all__ if name != "__version__"]
    assert len(set(names)) == len(names)
    assert set(names) <= set(dir(tc))
    assert not set(names) & set(dir(builtins))
    with pytest.raises(AttributeError, match="'tenscontrol' has no attribute 'nothing'"):
        _ = tc.nothing


def test_every_public_name_is_on_the_page_of_the_interface():
    page = (PROJECT / "docs" / "api.rst").read_text(encoding="utf-8")
    named = set(re.findall(r"::\s+([\w.]+)", page))
    last = {name.rsplit(".", 1)[-1] for name in named}
    assert [name for name in tc.__all__ if name != "__version__" and name not in last] == []
