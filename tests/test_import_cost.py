"""What an import loads, and what it does not: libraries wait until they are used."""

import subprocess
import sys

import pytest

import tenscontrol as tc


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


def test_naming_everything_public_loads_no_controller_and_no_plots():
    modules = loaded_by("import tenscontrol as tc\n[getattr(tc, name) for name in tc.__all__]")
    assert not modules & {"matplotlib", "control", "osqp", "tqdm"}


def test_a_model_and_its_run_in_open_loop_load_no_controllers_plots_or_files():
    modules = loaded_by(
        "import numpy as np, tenscontrol as tc, tenscontrol.structure, tenscontrol.dynamics\n"
        "model = tc.Model(tc.library.prism(), strings=tc.LinearStrings(100.0))\n"
        "prism = model.structure\n"
        "model.acceleration(prism.nodes, np.zeros((3, 6)), np.ones(9))\n"
        "tc.simulate(model, 0.01, rest_length=0.9)"
    )
    others = ("control", "estimation", "plant", "statics", "sizing", "actuation", "shape")
    ours = {name for name in modules if name.startswith("tenscontrol.")}
    assert not ours & {f"tenscontrol.{name}" for name in others}
    assert "casadi" in modules
    assert not modules & {"scipy", "tomllib", "matplotlib", "control", "osqp"}


def test_a_name_that_is_not_there_has_the_nearest_that_is():
    with pytest.raises(AttributeError, match="no name simulat; did you mean simulate"):
        _ = tc.simulat
