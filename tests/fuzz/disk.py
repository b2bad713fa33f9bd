"""Every writer of the package on disks that fail: the old file stays whole, the error says why.

``python -m tests.fuzz.disk`` runs all writers against all faults and prints a table; ``--count``
sets at how many places a file is broken off, and how many processes are killed. A file system of
300 kB is mounted where that is allowed (root on Linux, in a name space of its own). What this
machine cannot do is said and left out.
"""

import argparse
import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from pathlib import Path
from unittest import mock

import numpy as np

import tenscontrol as tc
from tests.deploy import scenes

OLD = b"what was there before"

# The kernel's, of the small file system.
SIZE = 300  # kB
MOUNT = f"mount -t tmpfs -o size={SIZE}k none"


# ---- the writers, by the name of what they write ----


@cache
def run():
    return tc.simulate(tc.Model(tc.prism()), 0.05, force_density=20.0, step=1e-3)


@cache
def figure():
    return tc.plot.structure(tc.prism()).ax.figure


@cache
def measured():
    case = tc.Scene(tc.Model(tc.prism()), 0.05, force_density=20.0)
    return tc.accuracy.work_precision(case, methods=["rk4"], repeats=1)


@cache
def controller():
    return tc.MPC(
        scenes.plant("force_density"), horizon=2, sample_time=scenes.SAMPLE, max_force_density=80.0
    )


WRITERS = {
    "run.npz": lambda path: run().save(path),
    "run.csv": lambda path: run().to_csv(path),
    "prism.toml": lambda path: tc.prism().save(path),
    "accuracy.csv": lambda path: measured().to_csv(path),
    "figure.png": lambda path: tc.plot.save_figure(figure(), path),
    "figure.pdf": lambda path: tc.plot.save_figure(figure(), path),
    "figure.svg": lambda path: tc.plot.save_figure(figure(), path),
    "run.gif": lambda path: tc.plot.animate(run(), path, fps=20, dpi=40),
    "run.html": lambda path: run().to_html(path),
    "shape.vtp": lambda path: tc.exchange.to_vtk(run().structure, path),
    "code": lambda path: tc.generate_c(controller(), path),
}


# ---- faults: contexts in which the disk fails ----


@contextmanager
def broken_off(size):
    """No file may have more bytes: the write that goes further ends there, by the kernel."""
    import resource  # POSIX

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@contextmanager
def unplugged(call):
    """A call of the system fails, and nothing can be removed any more."""
    error = OSError(errno.EIO, os.strerror(errno.EIO))
    with mock.patch(f"os.{call}", side_effect=error):
        yield


@contextmanager
def nobody():
    """This process belongs to a user who may write nothing."""
    os.setresuid(65534, 65534, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)


@contextmanager
def full(place, left):
    """A file system with so many bytes left."""
    ballast = place / "ballast"
    found = os.statvfs(place)
    ballast.write_bytes(b"x" * max(0, found.f_bavail * found.f_frsize - left))
    try:
        yield
    finally:
        ballast.unlink()


@contextmanager
def read_only(place):
    subprocess.run(["mount", "-o", "remount,ro", place], check=True)
    try:
        yield
    finally:
        subprocess.run(["mount", "-o", "remount,rw", place], check=True)


# ---- one attempt ----


def contents(folder):
    """What a folder holds, by name, but not what fills the disk."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
        if path.name != "ballast"
    }


def attempt(name, path, fault):
    """Let a writer write under a fault; return what is wrong with how it fails, or None.

    Where there can be a file at the path, an old one is there.
    """
    can_be = len(path.name) < 200 and path.parent.is_dir() and not path.exists()
    if old := can_be and name != "code":
        path.write_bytes(OLD)
    before = contents(path.parent) if path.parent.is_dir() else None
    wrong = None
    try:
        with fault:
            WRITERS[name](path)
    except OSError as error:
        if path.name[:40] not in str(error) and "TMPDIR" not in str(error):
            wrong = f"the path is not named: {error}"
        elif not re.search(r"[;:,] (write|give|make|free) ", str(error)):
            wrong = f"not said what to do: {error}"
    except Exception as error:
        wrong = f"no OSError, but {error!r}"
    else:
        wrong = "no error"
    after = contents(path.parent) if path.parent.is_dir() else None
    if wrong is None and after != before:
        wrong = f"left {sorted(after)}"
    if old:
        path.unlink()
    elif name == "code" and before is not None and path.name not in before:
        shutil.rmtree(path, ignore_errors=True)
    return wrong


def size_of(name, folder):
    """How many bytes a writer writes; of a folder, the largest file."""
    with tempfile.TemporaryDirectory(dir=folder) as inside:
        path = Path(inside) / name
        WRITERS[name](path)
        return max(each.stat().st_size for each in (path, *path.glob("*")) if each.is_file())


def places(whole, count):
    """Where a file of so many bytes breaks off: at its ends, and between."""
    return sorted({0, whole - 1, *(int(k) for k in np.linspace(0, whole - 1, count))})


def trials(name, folder, count):
    """Yield label, path and fault of what needs no file system of its own."""
    path = folder / name
    if os.name == "posix":
        for size in places(size_of(name, folder), count):
            yield "broken off by the kernel", path, broken_off(size)
        # Another user must be able to read the package, which may lie in a private folder.
        here = Path(tc.__file__).resolve().parents
        if (
            hasattr(os, "setresuid")
            and os.geteuid() == 0
            and all(each.stat().st_mode & 0o005 == 0o005 for each in here)
        ):
            yield "folder of another user", path, nobody()
    yield "name too long", folder / (200 * "ä" + name), nullcontext()
    (folder / "file").write_bytes(OLD)
    yield "file in place of a folder", folder / "file" / name, nullcontext()
    (folder / "file").unlink()
    path.mkdir()
    (path / "inside").write_bytes(OLD)
    yield "folder in place of a file", path, nullcontext()
    (path / "inside").unlink()
    path.rmdir()
    for call in ("fsync", "replace"):
        yield "unplugged", path, unplugged(call)
    if name != "code":  # a folder is made
        yield "no folder", folder / "absent" / name, nullcontext()
        if Path("/dev/full").exists():
            link = (folder / "full").with_suffix(path.suffix)
            link.symlink_to("/dev/full")
            yield "link to a full device", link, nullcontext()
            link.unlink()


def small_trials(name, place, count):
    """Yield those on the small file system."""
    path = place / name
    size = min(size_of(name, None), 1024 * SIZE)
    for left in places(size, count):
        # Less than a page is nothing, and the old file has one already.
        if left + 4096 < size:
            yield "full", path, full(place, left)
    yield "full", path, full(place, 0)
    yield "read-only", path, read_only(place)


def tried(name, folder, count, small=False):
    """Return what is wrong in all trials of a writer, by label: texts, or None for nothing."""
    found = {}
    for label, path, fault in (small_trials if small else trials)(name, folder, count):
        found.setdefault(label, []).append(attempt(name, path, fault))
    return found


# ---- what is not an error ----


def slow(name, folder):
    """Read a file while it is written to a slow disk; return what is wrong, or None."""
    path = folder / name
    path.write_bytes(OLD)
    seen, is_written = set(), threading.Event()
    sync = os.fsync

    def fsync(file):
        seen.add(path.read_bytes())
        time.sleep(0.05)
        seen.add(path.read_bytes())
        sync(file)
        is_written.set()

    with mock.patch("os.fsync", fsync):
        WRITERS[name](path)
    new = path.read_bytes()
    path.unlink()
    if not is_written.is_set():
        return "not flushed"
    return None if seen == {OLD} and new != OLD else "seen half-written"


_WRITE = """
import sys
from pathlib import Path
from tenscontrol.files import write_file
texts = [bytes([65 + i]) * 2_000_000 for i in range(2)]
print(flush=True)
for i in range(10**9):
    write_file(Path(sys.argv[1]), texts[i % 2])
"""


def killed(folder, count):
    """Kill processes while they write; return what is wrong, or None, for each."""
    rng = np.random.default_rng(1)
    path = folder / "file"
    found = []
    for _ in range(count):
        with subprocess.Popen([sys.executable, "-c", _WRITE, path], stdout=subprocess.PIPE) as one:
            one.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.1))
            one.send_signal(signal.SIGKILL)
        content = path.read_bytes() if path.exists() else b""
        whole = content in (b"", b"A" * 2_000_000, b"B" * 2_000_000)
        found.append(None if whole else f"torn at {len(content)} bytes")
    return found


# ---- the command ----


def can_mount():
    """Whether this process may mount a file system in a name space of its own."""
    command = ["unshare", "-m", "sh", "-c", f"{MOUNT} /mnt"]
    with suppress(OSError):
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    return False


def rows(count, small, names=tuple(WRITERS)):
    """Yield writer, fault, how often it was tried, and what is wrong."""
    with tempfile.TemporaryDirectory() as work:
        place = Path(work)
        place.chmod(0o755)  # for another user to look into
        if small:
            subprocess.run([*MOUNT.split(), work], check=True)
        try:
            for name in names:
                for label, found in tried(name, place, count, small).items():
                    yield name, label, found
                if not small and name != "code":
                    yield name, "slow", [slow(name, place)]
            if not small:
                yield "write_file", "killed", killed(place, count)
        finally:
            if small:
                subprocess.run(["umount", work], check=True)


def main(arguments=None):
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.disk", description=__doc__)
    parser.add_argument("--count", type=int, default=20, help="places and kills (default: 20)")
    parser.add_argument("--small", action="store_true", help="on the small file system alone")
    parser.add_argument("--only", nargs="*", default=list(WRITERS), choices=WRITERS, metavar="NAME")
    options = parser.parse_args(arguments)
    wrong = 0
    for name, label, found in rows(options.count, options.small, options.only):
        said = Counter(each for each in found if each is not None)
        wrong += sum(said.values())
        print(f"{name:12s} {label:26s} {len(found):5d} tried {sum(said.values()):5d} wrong")
        for text, times in said.most_common(2):
            print(f"    {times} x {text}")
    if not options.small:
        sys.stdout.flush()
        if can_mount():
            given = ["--small", "--count", str(options.count), "--only", *options.only]
            command = ["unshare", "-m", sys.executable, "-m", "tests.fuzz.disk", *given]
            wrong += subprocess.run(command, check=False).returncode
        else:
            print("no file system can be mounted here: full and read-only disks are left out")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
