"""Memory and functions that generated code needs, here and on a microcontroller."""

from shutil import which

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.dynamics.machine_code import CompilerError
from tests.deploy import scenes

# Of the C library and of compilers: nothing that allocates, prints or reads.
ALLOWED = {
    "acos", "asin", "atan", "atan2", "cos", "exp", "fabs", "fma", "fmax", "fmin", "log", "lround",
    "floor", "memcpy", "memmove", "memset", "pow", "round", "sin", "sqrt", "sincos", "tan", "tanh",
    "__stack_chk_fail", "isfinite", "nearbyint", "rint",
}  # fmt: skip

FLOATS = ("-mthumb", "-mfloat-abi=hard", "-Os")
MACHINES = {
    "Cortex-M4F": ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", *FLOATS),
    "Cortex-M7": ("-mcpu=cortex-m7", "-mfpu=fpv5-d16", *FLOATS),
}
LAWS = {
    "LQR": scenes.rolling,
    "MPC": scenes.of_rest_length,
    "NMPC": scenes.crossed,
}


@pytest.mark.skipif(
    not all(map(which, ("cc", "size", "nm"))), reason="needs a compiler, size and nm"
)
@pytest.mark.parametrize("law", LAWS)
def test_code_needs_no_more_than_some_functions(law, tmp_path):
    options = ("-Os",) if law == "LQR" else ("-O0",)  # in a tenth of the time
    use = tc.generate_c(LAWS[law](), tmp_path).memory(options=options)
    assert set(use.functions) <= ALLOWED
    numbers = sum(path.stat().st_size for path in tmp_path.glob("*_data.h"))
    assert 1000 < use.flash < 2**20 + numbers
    assert 100 < use.ram < use.flash * 4
    assert str(use).startswith(f"flash {use.flash / 1024:.1f} kB, RAM {use.ram / 1024:.1f} kB")


@pytest.mark.skipif(which("arm-none-eabi-gcc") is None, reason="needs arm-none-eabi-gcc")
@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("law", LAWS)
def test_code_for_a_microcontroller(law, machine, tmp_path):
    use = tc.generate_c(LAWS[law](), tmp_path).memory("arm-none-eabi-gcc", MACHINES[machine])
    own = {name for name in use.functions if name.startswith("__aeabi_")}
    assert set(use.functions) - own <= ALLOWED
    assert 1000 < use.flash < 2**21


def test_what_does_not_compile_or_is_not_there_is_said(tmp_path):
    made = tc.generate_c(scenes.rolling(), tmp_path)
    with pytest.raises(FileNotFoundError, match="compiler is 'no-such-gcc', but 'no-such-gcc' is"):
        made.memory("no-such-gcc")
    with open(tmp_path / "controller.c", "a") as file:
        file.write("int unused(void) { int *p = 1.0; return 0; }\n")
    with pytest.raises(CompilerError, match="failed: "):
        made.memory()


def test_changed_files_are_overwritten_if_asked(tmp_path):
    made = tc.generate_c(scenes.rolling(), tmp_path)
    text = (tmp_path / "controller.c").read_text()
    (tmp_path / "controller.c").write_text("changed")
    with pytest.raises(FileExistsError, match=r"'controller\.c'.*give overwrite=True"):
        tc.generate_c(scenes.rolling(), tmp_path)
    again = tc.generate_c(scenes.rolling(), tmp_path, overwrite=True)
    assert again.files == made.files
    assert (tmp_path / "controller.c").read_text() == text
    (tmp_path / "SHA256SUMS").unlink()
    with pytest.raises(FileExistsError, match="or overwrite=True"):
        tc.generate_c(scenes.rolling(), tmp_path)
    tc.generate_c(scenes.rolling(), tmp_path, overwrite=True)
    (tmp_path / "mine.c").write_text("int mine;")
    with pytest.raises(FileExistsError, match=r"'mine\.c', which is not as"):
        tc.generate_c(scenes.rolling(), tmp_path, overwrite=True)
    assert (tmp_path / "mine.c").exists()
    assert np.isfinite(again.sizes).all()
