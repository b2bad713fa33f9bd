"""Run the tests of the core on one that watches its memory and undefined behaviour.

Run: ``python -m tests.watched_core``, with gcc. It builds the core anew, in a folder that is
thrown away, with the address and the undefined-behaviour sanitizers.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

PROJECT = Path(__file__).parent.parent
TESTS = (
    "tests/integrate/test_core_scene.py", "tests/integrate/test_core_run.py",
    "tests/simulation/test_batch.py", "tests/optimize/test_core_steps.py",
    "tests/control/mpc/test_slopes.py",
)  # fmt: skip
# Without optimization: sanitized, the runs in lanes compile in a fifth of the time.
FLAGS = ("-O0", "-g", "-std=c99", "-fPIC", "-shared", "-fno-sanitize-recover=all")

# The sanitizer refuses libraries that bind to their own symbols first, as CasADi asks of its own.
DLOPEN = """\
#define _GNU_SOURCE
#include <dlfcn.h>
void *dlopen(const char *file, int flags) {
  void *(*next)(const char *, int) = (void *(*)(const char *, int))dlsym(RTLD_NEXT, "dlopen");
  return next(file, flags & ~RTLD_DEEPBIND);
}
"""

# An editable installation finds its own package and core before those of the folder.
TESTED_HERE = """
import sys
from pathlib import Path
sys.meta_path = [finder for finder in sys.meta_path if "editable" not in type(finder).__module__]
from tenscontrol.core.library import library
core = Path(library()._name)
if not core.is_relative_to(Path.cwd()):
    sys.exit(f"the core is that of {core}, expected the one that is watched")
import pytest
sys.exit(pytest.main(sys.argv[1:]))
"""


def main() -> int:
    """Build the core and run its tests; return what pytest returned."""
    from tenscontrol.core.library import NAME, sources_id

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("tenscontrol", "tests", "pyproject.toml"):
            source = PROJECT / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, copy / name)
        core = copy / "tenscontrol" / "core"
        sources = sorted(map(str, core.glob("*.c")))
        subprocess.run(
            ["gcc", *FLAGS, "-fsanitize=address,undefined",
             f'-DTENSCONTROL_SOURCES="{sources_id()}"', "-o", str(core / NAME), *sources, "-lm"],
            check=True,
        )  # fmt: skip
        (copy / "dlopen.c").write_text(DLOPEN)
        subprocess.run(
            ["gcc", "-shared", "-fPIC", "-o", "dlopen.so", "dlopen.c", "-ldl"], cwd=copy, check=True
        )
        libraries = [
            subprocess.run(
                ["gcc", f"-print-file-name={name}"], check=True, capture_output=True, text=True
            ).stdout.strip()
            # The sanitizer passes on what C++ throws, if it sees the library of C++ at its start.
            for name in ("libasan.so", "libstdc++.so.6")
        ]
        # Python itself leaks; and what it loads is not told apart from the core.
        watched = {
            "LD_PRELOAD": " ".join([str(copy / "dlopen.so"), *libraries]),
            "ASAN_OPTIONS": "detect_leaks=0:verify_asan_link_order=0",
        }
        # A capture would swallow what the sanitizer says as it ends the process.
        command = [sys.executable, "-c", TESTED_HERE, "-qs", "-p", "no:cacheprovider", *TESTS]
        return subprocess.run(command, cwd=copy, env=os.environ | watched, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
