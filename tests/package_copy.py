"""A copy of the package, to which a test adds something, and in which it runs a script."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import tenscontrol as tc

_PACKAGE = Path(tc.__file__).parent

# The finder of an editable installation comes before every path.
_PAST_EDITABLE = """
sys.meta_path[:] = [
    finder for finder in sys.meta_path if not type(finder).__module__.startswith("_editable_")
]
"""


class PackageCopy:
    """A copy of the package in a folder, with the files that were changed or added in it.

    ``others`` are folders of the project that are copied too.
    """

    def __init__(self, folder: Path, *others: str) -> None:
        self._folder = folder
        self.changed: set[str] = set()
        skipped = shutil.ignore_patterns("images")  # compiled modules go along
        for path in (_PACKAGE.name, *others):
            shutil.copytree(_PACKAGE.parent / path, folder / path, ignore=skipped)

    def add(self, path: str, text: str) -> None:
        """Add a file; ``path`` is relative to the package."""
        file = self._folder / _PACKAGE.name / path
        assert not file.exists(), f"{path} is there already"
        file.write_text(text, encoding="utf-8")
        self.changed.add(path)

    def replace(self, path: str, old: str, new: str) -> None:
        """Replace what stands once in a file; ``path`` is relative to the package."""
        file = self._folder / _PACKAGE.name / path
        text = file.read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{path} has {text.count(old)} times {old!r}, expected once"
        file.write_text(text.replace(old, new), encoding="utf-8")
        self.changed.add(path)

    def run(self, script: str) -> str:
        """Return what a script prints that imports the copy; it fails where the script does."""
        here = f"import sys; sys.path.insert(0, {str(self._folder)!r})\n" + _PAST_EDITABLE
        checked = (
            f"import tenscontrol; assert tenscontrol.__file__.startswith({str(self._folder)!r})\n"
        )
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", here + checked + script],
            cwd=self._folder,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout
