"""Reference motions of random scenes, kept in files: where they are certain, and to what.

A reference is the oracle's motion at 20 equal times. It is certain to the difference of a tight run
of the package, which shares no code with it: a motion that magnifies errors is certain up to a
time. Where oracle and package disagree while the oracle agrees with itself at another tolerance,
the package is suspect, and the reference says so.

    scene = random_scene(7)
    found = reference(scene, folder)   # computed once, then read
    found.nodes[:, :, found.judged], found.times[found.judged]
"""

from __future__ import annotations

import os
import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from tenscontrol.simulation import AccuracyWarning, SimulationError
from tests.located_motion import OracleError
from tests.random_scenes import Scene

#: Times at which runs are judged, and how certain they must be, as part of the size.
TIMES, CERTAIN = 20, 1e-3

# Evaluations of the oracle, and processor time of the tight run, s.
_EVALUATIONS, _SECONDS = 3_000_000, 60.0

# A change of this is a change of all references.
_VERSION = 1


class TimeLimitError(BaseException):
    """The processor time is used up. Not an Exception: nothing on the way must catch it."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference nodes of a scene.

    ``times`` (T,) in s from 0; ``nodes`` (d, n, T) in m; ``certain_to`` (T,), the difference from
    the tight run as part of the size, NaN where there is none; ``status`` is ``"ok"``, why there is
    no reference, or ``"suspect"``: the oracle agrees with itself and the package differs.
    """

    times: np.ndarray
    nodes: np.ndarray
    certain_to: np.ndarray
    status: str
    switches: int

    @property
    def judged(self) -> np.ndarray:
        """Indices of the times at which runs can be judged: up to the first uncertain one."""
        certain = self.certain_to <= CERTAIN
        return np.flatnonzero(np.logical_and.accumulate(certain))[1:]

    @property
    def is_certain_to_the_end(self) -> bool:
        """Whether the last time can be judged."""
        return len(self.judged) == TIMES


def default_folder() -> Path:
    """Return where references are kept if no folder is given."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "tenscontrol-tests" / "references"


def reference(scene: Scene, folder: Path | str | None = None) -> Reference:
    """Return the reference of a scene: read from the folder, or computed and written there."""
    path = Path(folder or default_folder()) / f"scene_{scene.seed:06d}.npz"
    key = fingerprint(scene)
    if path.exists():
        with np.load(path) as kept:
            if str(kept["key"]) == key:
                return Reference(**{
                    name: kept[name] if kept[name].ndim else kept[name].item()
                    for name in Reference.__dataclass_fields__
                })  # fmt: skip
    found = _computed(scene)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.npz")
    np.savez_compressed(part, key=key, **asdict(found))
    part.replace(path)
    return found


def fingerprint(scene: Scene) -> str:
    """Return what changes with anything of the scene."""
    structure, law = scene.structure, scene.strings
    parts: list[object] = [
        _VERSION, structure.nodes, structure.bars, structure.paths, structure.strings,
        structure.fixed, structure.rollers, structure.bar_mass, structure.point_mass,
        type(law).__name__, *(getattr(law, name) for name in law.__dataclass_fields__),
        scene.gravity, scene.external_force, scene.velocities, scene.input, scene.value,
        scene.duration,
        *(getattr(each, name) for each in scene.ground for name in each.__dataclass_fields__),
    ]  # fmt: skip
    text = "|".join(p.tobytes().hex() if isinstance(p, np.ndarray) else repr(p) for p in parts)
    return sha256(text.encode()).hexdigest()


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise TimeLimitError once the process has used this processor time, and each second after."""

    def stop(*_: object) -> None:
        raise TimeLimitError(f"more than {seconds:g} s of processor time")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def error_between(scene: Scene, nodes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the largest difference of a coordinate at each time, as part of the size."""
    return np.abs(nodes - others).max(axis=(0, 1)) / scene.size


def _computed(scene: Scene) -> Reference:
    times = np.linspace(0.0, scene.duration, TIMES + 1)
    uncertain = np.full(TIMES + 1, np.nan)
    nothing = np.zeros((*scene.structure.nodes.shape, TIMES + 1))
    try:
        nodes, work = scene.located(times, 1e-12, _EVALUATIONS)
    except OracleError as error:
        return Reference(times, nothing, uncertain, f"oracle: {error}", 0)
    try:
        with time_limit(_SECONDS), warnings.catch_warnings():
            warnings.simplefilter("ignore", AccuracyWarning)
            run = scene.simulate(method="dop853", tolerance=1e-12, output_step=times[1])
    except TimeLimitError as error:
        return Reference(times, nodes, uncertain, f"tight run: {error}", work.switches)
    except SimulationError as error:
        return Reference(times, nodes, uncertain, f"tight run: {error}", work.switches)
    certain = error_between(scene, run.nodes[:, :, places(run.time, times)], nodes)
    status = "ok"
    if (certain > CERTAIN).any():
        again, _ = scene.located(times, 1e-11, 2 * _EVALUATIONS)
        own = error_between(scene, again, nodes)
        if ((own < 1e-3 * CERTAIN) & (certain > CERTAIN)).any():
            status = "suspect"
    return Reference(times, nodes, certain, status, work.switches)


def places(times: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return where the wanted times are among others."""
    places = np.abs(times[:, None] - wanted).argmin(axis=0)
    apart = np.abs(times[places] - wanted).max()
    if apart > 1e-9 * wanted[-1]:
        raise ValueError(f"a time is {apart:g} s from those of the run")
    return places
