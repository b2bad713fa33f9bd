"""Generated C is clean under the sanitizers; ``python -m tests.fuzz.sanitizers`` runs all of it."""

import pytest

from tests.fuzz import sanitizers

pytestmark = pytest.mark.skipif(
    not sanitizers.can_sanitize(), reason="there is no compiler with sanitizers"
)


@pytest.mark.parametrize("name", ["crossed", "rolling"])
def test_controllers_on_absurd_samples(name):
    assert sanitizers.check_controller(name, 66) == 132


@pytest.mark.parametrize(
    "line",
    [
        "return (int)(1e300 * count);",
        "int places[2] = {0}; return places[count + 1];",
        "int *place = (int *)names + 1000000000; return *place;",
        "return 1 << (31 + count);",
    ],
)
def test_a_fault_is_found(line, tmp_path):
    text = f"int main(int count, char **names) {{ (void)names; {line} }}"
    (tmp_path / "main.c").write_text(text)
    sanitizers.build(["main.c"], tmp_path, sanitizers.CHECKED)
    with pytest.raises(AssertionError, match=r"runtime error|AddressSanitizer"):
        sanitizers.run(["./program"], tmp_path)


def test_loops_over_the_members():
    assert sanitizers.check_loops("loops on supports", 24) >= 24
