"""What a worker of a sweep does: one run, from nothing but its arguments."""

from __future__ import annotations

import pickle
import signal
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from tenscontrol.robustness.distributions import Distribution, Drawn
from tenscontrol.robustness.errors import SweepError
from tenscontrol.robustness.outcome import Outcome
from tenscontrol.robustness.record import Record
from tenscontrol.validation import frozen

# Streams of random numbers of a run: one for each parameter, by its name, and one for the case.
# So a further parameter changes nothing of what the others and the case draw.
_PARAMETERS, _CASE = 0, 1


def run_one(case: bytes, parameters: Mapping[str, Distribution], seed: int, run: int) -> Record:
    """Return the record of one run.

    The case comes pickled and is loaded anew for each run, so that nothing that one run leaves
    in it (the last plan of a controller, say) reaches another. The random numbers hang on the
    seed and the index alone. So it does not matter which worker does a run, or when.
    """
    function = _loaded(case)
    drawn = {
        name: distribution.draw(_generator(seed, run, _PARAMETERS, *name.encode()))
        for name, distribution in parameters.items()
    }
    given = {
        name: frozen(np.array(value)) if isinstance(value, list) else value
        for name, value in drawn.items()
    }
    try:
        outcome = function(given, _generator(seed, run, _CASE))
    except (SweepError, MemoryError):
        raise  # the sweep is wrong, or the machine too small: the next runs would be no better
    except Exception as error:
        # Whatever a case raises is what the sweep was run to find: it is kept as data, with its
        # kind and text, and counts as no success. What is no Exception, like Ctrl-C, goes on.
        return _failed(run, drawn, error)
    if not isinstance(outcome, Outcome):
        raise SweepError(
            f"the case returned a {type(outcome).__name__}, expected Outcome: end it with "
            "return Outcome(success=..., figures={...})"
        )
    return Record(run, drawn, outcome.success, outcome.figures)


def ignore_interrupts() -> None:
    """Leave Ctrl-C to the parent process.

    A simulation that is interrupted returns the part that is done, which must not pass for a
    whole run.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _loaded(case: bytes) -> Callable[..., Any]:
    try:
        function: Callable[..., Any] = pickle.loads(case)
    except (AttributeError, ImportError) as error:
        raise SweepError(
            f"a worker cannot load the case: {error}. Define it in a module that workers can "
            "import, or in the script itself above `if __name__ == '__main__':`"
        ) from None
    return function


def _generator(seed: int, *key: int) -> np.random.Generator:
    """Return the generator that ``SeedSequence(seed)`` spawns at this key."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def _failed(run: int, drawn: dict[str, Drawn], error: Exception) -> Record:
    return Record(run, drawn, success=False, error=type(error).__name__, message=str(error))
