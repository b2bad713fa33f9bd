"""Compiling takes longer here than running what was compiled."""

import hashlib
import subprocess

import pytest

from tenscontrol.deploy import compiled_controller
from tenscontrol.dynamics.machine_code import FLAGS, Compiler


@pytest.fixture(autouse=True, scope="package")
def quick_to_compile(tmp_path_factory):
    """Compile without optimization, but the files of the solver, once for all controllers."""
    original, objects = Compiler.link, {}
    flags = [flag for flag in FLAGS if flag != "-shared"]

    def link(self, sources, folder, name, timeout, extra=()):
        own = name.removeprefix("lib")
        shared = [source for source in sources if not source.name.startswith(own)]
        start = hashlib.sha256(repr((self, extra)).encode())
        for header in sorted(sources[0].parent.glob("*.h")):
            if not header.name.startswith(own):
                start.update(header.read_bytes())
        keys = {}
        for source in shared:
            digest = start.copy()
            digest.update(source.read_bytes())
            keys[source] = digest.hexdigest()
        missing = [source for source, key in keys.items() if key not in objects]
        if missing:
            made = tmp_path_factory.mktemp("objects")
            command = [*self.command, *flags, *extra, "-O1", "-c", *map(str, missing)]
            if subprocess.run(command, cwd=made, capture_output=True).returncode:
                return original(self, sources, folder, name, timeout, extra)
            objects.update((keys[source], made / f"{source.stem}.o") for source in missing)
        files = [objects[keys[source]] if source in keys else source for source in sources]
        return original(self, files, folder, name, timeout, extra)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled_controller, "OPTIMIZATION", "-O0")
        patch.setattr(Compiler, "link", link)
        yield
