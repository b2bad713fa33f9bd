"""A sample of one robot in fixed steps of the compiled core, in memory that is kept."""

from __future__ import annotations

import ctypes

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.core import records
from tenscontrol.integrate.core_run import settings_of
from tenscontrol.integrate.core_scene import CoreScene
from tenscontrol.integrate.methods import Method

# Steps that the core may take in one call: all of a sample.
_ALL = 2**31 - 1


class CoreSample:
    """What advances a state over samples, to the bits of :class:`CoreMotion`.

    Parameters
    ----------
    scene : CoreScene
    method : Method
        "rk4" or "rk4_plain".
    step : float
        s, at most.
    inputs : int
        Numbers of an input.
    """

    def __init__(self, scene: CoreScene, method: Method, step: float, inputs: int) -> None:
        states, switches = scene.states, scene.switches
        self._u, self._state, self._taut = np.zeros(inputs), np.empty(states), np.empty(switches)
        self._outputs = np.empty((states, 2))
        self._settings = settings_of(method.name, 1.0, 1, method.projects, step=step)
        self._settings.budget = _ALL
        self._locates = method.locates
        self._progress = records.Progress()
        self._fresh = bytes(records.Progress(step=step, every=1))
        self._drive = scene.drive(self._u)
        self._kept = scene, np.empty(0), np.empty(scene.work_size)
        none, work = self._kept[1:]
        state, taut, at = _data(self._state), _data(self._taut), ctypes.byref
        self._advance, self._find_taut = scene.core.tc_advance, scene.core.tc_taut
        self._of_taut = scene.at, at(self._drive), state, taut, _data(work)
        self._of_sample = (
            scene.at, at(self._drive), scene.lengths_at, at(self._settings),
            at(self._progress), state, _data(none), taut, _data(self._outputs), _data(none),
            _data(none), _data(none), _data(work),
        )  # fmt: skip

    def advance(self, state: FloatArray, u: FloatArray, duration: float) -> FloatArray | None:
        """Return the state after a sample under an input; None where the motion ends within."""
        self._u[:], self._state[:] = u, state
        ctypes.memmove(ctypes.byref(self._progress), self._fresh, len(self._fresh))
        self._settings.duration = duration
        if self._locates:
            self._find_taut(*self._of_taut)
        return self._state.copy() if self._advance(*self._of_sample) == 1 else None


def _data(array: FloatArray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
