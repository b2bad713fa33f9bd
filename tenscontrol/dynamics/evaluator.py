"""CasADi functions in a program with threads.

What has a memory is used by one thread at a time as well, and the BLAS has one thread meanwhile.

CasADi's Python wrapper lets other threads run during every call, and expressions share constants
and patterns. Functions that are made or freed while another thread builds end the process within
minutes (seen with 3.7.0 to 3.8.2). So what makes, copies or frees expressions, in any thread, takes
the lock below. Evaluating functions needs no lock.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from threading import Lock, RLock, get_ident
from traceback import clear_frames
from typing import Any, ClassVar, Concatenate, ParamSpec, TypeVar

import casadi as ca
import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.properties import cached_property

_Arguments = ParamSpec("_Arguments")
_Self = TypeVar("_Self")
_Value = TypeVar("_Value")

#: Held by the thread that builds with CasADi, or compiles or solves what it has built; never while
#: it waits for an executor.
BUILDING: Any = RLock()


class ProcessLock:
    """A lock that each process has for itself.

    A child that is forked while a thread holds the lock does not have that thread: it would wait
    for ever. What the lock guards must bear that another call on it was never finished.
    """

    def __init__(self) -> None:
        self._locks: dict[int, Any] = {}

    def __enter__(self) -> None:
        self._of_process().acquire()

    def __exit__(self, *_: object) -> None:
        self._of_process().release()

    def _of_process(self) -> Any:
        return self._locks.setdefault(os.getpid(), Lock())


class _Guarded:
    """Frees objects of CasADi where no other thread builds, else leaves them to that thread.

    Waiting in ``__del__`` could wait for ever.
    """

    # Of the class: at the end of the process, names of modules are gone before the last objects.
    _dropped: ClassVar[deque[Any]] = deque()
    _lock = BUILDING

    @classmethod
    def free(cls) -> None:
        """Free what other threads have dropped, by the thread that holds the lock."""
        cls._dropped.clear()

    def _drop(self, *objects: Any) -> None:
        self._dropped.extend(objects)
        if self._lock.acquire(blocking=False):
            try:
                self.free()
            finally:
                self._lock.release()


class Function(ca.Function, _Guarded):  # type: ignore[misc]  # CasADi has no types
    """A CasADi function that is freed and pickled while no other thread builds."""

    def __del__(self) -> None:
        """Free what CasADi holds; Ctrl-C while it was made has left nothing."""
        if hasattr(self, "this"):
            self._drop(self.this)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the serialized function."""
        with BUILDING:
            return _deserialized, (self.serialize(),)


def _deserialized(data: str) -> Function:
    with BUILDING:
        return Function(ca.Function.deserialize(data))


def _guarded(value: Any) -> Any:
    """Return what is kept: functions, alone or in a tuple, guarded."""
    if type(value) is tuple:
        return tuple(map(_guarded, value))
    return Function(value) if type(value) is ca.Function else value


def builds(function: Callable[_Arguments, _Value]) -> Callable[_Arguments, _Value]:
    """Let one thread at a time call a function that builds with CasADi."""

    @wraps(function)
    def locked(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Value:
        with BUILDING:
            _Guarded.free()
            try:
                return function(*args, **kwargs)
            except BaseException as error:
                # Expressions of a build that failed must end under the lock as well.
                clear_frames(error.__traceback__)
                raise

    return locked


class built(cached_property[_Value]):  # noqa: N801, as cached_property
    """A property that is built with CasADi at its first use."""

    def __init__(self, build: Callable[[Any], _Value]) -> None:
        super().__init__(wraps(build)(lambda instance: _guarded(build(instance))))

    def __get__(self, instance: object, owner: type[Any] | None = None) -> Any:
        """Return the value, built under the lock."""
        with BUILDING:
            return super().__get__(instance, owner)


if hasattr(os, "register_at_fork"):  # a forked child must not start in the middle of a build
    os.register_at_fork(
        before=BUILDING.acquire, after_in_parent=BUILDING.release, after_in_child=BUILDING.release
    )


# Products of matrices of up to so many rows and columns are done by one thread in any case.
_SMALL = 64


@cache
def _matrix_libraries() -> tuple[Any, Callable[[], object]]:
    """Return what controls the BLAS of NumPy and of SciPy, which is loaded, and what lets go of it.

    From 3.8 on threadpoolctl lets one thread alone set numbers until that lets go.
    """
    import scipy.linalg  # noqa: F401
    import threadpoolctl

    let_go = getattr(threadpoolctl.OpenBLASController, "clear_controlling_thread", lambda: None)
    return threadpoolctl.ThreadpoolController().select(user_api="blas"), let_go


class _OneThread:
    """The BLAS of the process has one thread while any thread of Python is within; may be nested.

    NumPy and SciPy each bring a BLAS with a thread for every core. After a product these threads
    wait for the next by spinning, so that those of one library take the cores from those of the
    other: matrices of some hundred rows become several times as slow.
    """

    def __init__(self) -> None:
        self._lock, self._within = ProcessLock(), 0
        self._limits: Any = None

    def __enter__(self) -> None:
        libraries, let_go = _matrix_libraries()
        with self._lock:
            if not self._within:
                self._limits = libraries.limit(limits=1)
                let_go()
            self._within += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._within -= 1
            if not self._within:
                self._limits.restore_original_limits()
                _matrix_libraries()[1]()


_ONE_THREAD = _OneThread()


def on_one_thread(function: Callable[_Arguments, _Value]) -> Callable[_Arguments, _Value]:
    """Let the BLAS have one thread while a function of large matrices runs."""

    @wraps(function)
    def limited(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Value:
        with _ONE_THREAD:
            return function(*args, **kwargs)

    return limited


_IN_USE = (
    "{} is in use by another thread, and it keeps state between calls. Give each thread a copy, "
    "for example by copy.deepcopy or pickle"
)


class Exclusive:
    """Refuses a second thread while one is inside; the same thread may enter again.

    Parameters
    ----------
    name : str
        The object that has a memory, for the message.
    size : int
        Rows or columns of its largest matrix: if they are many, the BLAS has one thread meanwhile.
    """

    def __init__(self, name: str, size: int = 0) -> None:
        self._what, self._user, self._depth = name, 0, 0
        self._size, self._limits = size, size > _SMALL

    def __enter__(self) -> None:
        """Take the object, or raise RuntimeError if another thread has it."""
        me = get_ident()
        if self._user != me:
            # No other thread can come between these two lines: nothing is called.
            if self._user:
                raise RuntimeError(_IN_USE.format(self._what))
            self._user = me
            if self._limits:
                _ONE_THREAD.__enter__()
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        """Leave the object to others."""
        self._depth -= 1
        if not self._depth:
            if self._limits:
                _ONE_THREAD.__exit__()
            self._user = 0

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy as an object that nobody uses."""
        return Exclusive, (self._what, self._size)


def exclusive(
    method: Callable[Concatenate[_Self, _Arguments], _Value],
) -> Callable[Concatenate[_Self, _Arguments], _Value]:
    """Let one thread at a time call a method of an object with an ``in_use``, an `Exclusive`."""

    @wraps(method)
    def alone(self: _Self, /, *args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Value:
        with self.in_use:  # type: ignore[attr-defined]
            return method(self, *args, **kwargs)

    return alone


# Distinct inputs, methods and settings of one model in a program; the oldest is dropped.
_MOST = 32


class Prepared:
    """Functions and matrices by key: bounded, thread-safe, and left out of pickles and copies."""

    def __init__(self) -> None:
        # Each value with the number of its last use, which threads may share. There is no lock for
        # what is done in one operation: a child that is forked meanwhile would wait for it.
        self._kept: dict[Hashable, list[Any]] = {}
        self._uses = 0

    def get(self, key: Hashable, build: Callable[[], _Value]) -> _Value:
        """Return what was built for a key; the first time, build it: anything but None.

        The key holds all that the value depends on, beside the owner of this object. Threads share
        the value, so it has no memory: functions, not evaluators.
        """
        try:
            entry = self._kept[key]
        except KeyError:
            return self._built(key, build)
        entry[1] = self._uses = self._uses + 1
        value: _Value = entry[0]
        return value

    def _built(self, key: Hashable, build: Callable[[], _Value]) -> _Value:
        """Build a value and keep it, by the thread that holds the lock."""
        with BUILDING:
            if key in self._kept:  # another thread was first
                return self.get(key, build)
            value: _Value = _guarded(build())
            self._uses += 1
            self._kept[key] = [value, self._uses]
            while len(self._kept) > _MOST:
                del self._kept[min(self._kept, key=lambda stored: self._kept[stored][1])]
            return value

    def __reduce__(self) -> tuple[type[Prepared], tuple[()]]:
        """Pickle and copy as an empty store."""
        return Prepared, ()


# Columns that are evaluated in one call, and functions mapped to so many.
_CHUNK = 32
_MAPPED = Prepared()


class Evaluator(_Guarded):
    """A CasADi function behind its buffer: about fifty times cheaper to call than the function.

    Outputs are views of memory that the next call overwrites; copy what must last. Inputs are
    trusted: callers check them. All inputs and outputs of the function must be dense. Each thread
    needs an evaluator of its own; a call during another thread's raises RuntimeError.
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._buffer, self._run = function.buffer()
        self._inputs: list[FloatArray] = []
        self._outputs: list[FloatArray] = []
        self._is_in_use = False
        self.calls = 0
        for i in range(function.n_in()):
            self._inputs.append(_dense(function.sparsity_in(i)))
            self._buffer.set_arg(i, _memory(self._inputs[i]))
        for i in range(function.n_out()):
            self._outputs.append(_dense(function.sparsity_out(i)))
            self._buffer.set_res(i, _memory(self._outputs[i]))

    def __del__(self) -> None:
        """Free function and buffer; Ctrl-C while they were made may have left none."""
        self._drop(*(vars(self).pop(name, None) for name in ("_function", "_buffer")))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the function; the memory is made anew."""
        with BUILDING:
            return Evaluator, (_guarded(self._function),)

    def __call__(self, *arguments: Any) -> list[FloatArray]:
        """Evaluate and return one array per output: a vector, or a matrix in Fortran order."""
        # A quarter of the time of a small function is saved by no Exclusive here.
        if self._is_in_use:
            raise RuntimeError(_IN_USE.format("this Evaluator"))
        self._is_in_use = True
        try:
            for target, argument in zip(self._inputs, arguments, strict=True):
                target[...] = argument
            self._run()
            self.calls += 1
        finally:
            self._is_in_use = False
        return self._outputs


class SharedEvaluator:
    """A function that threads may evaluate at once: each call takes an evaluator that is idle."""

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._idle: deque[Evaluator] = deque()

    def __call__(self, *arguments: Any) -> list[FloatArray]:
        """Evaluate and return new arrays, as `Evaluator` does."""
        with self.outputs(*arguments) as outputs:
            return [output.copy() for output in outputs]

    @contextmanager
    def outputs(self, *arguments: Any) -> Iterator[list[FloatArray]]:
        """Evaluate and yield arrays that no other call overwrites meanwhile."""
        with _taken(self._idle, Evaluator, self._function) as evaluator:
            yield evaluator(*arguments)


class ColumnEvaluator:
    """A function of dense column vectors, evaluated at any number of them without building anew.

    Columns are taken in chunks of one size, the last one filled up. The function is kept with its
    map to a chunk, for the next evaluator of the same function.
    """

    def __init__(self, function: ca.Function) -> None:
        self._rows = [function.size1_out(i) for i in range(function.n_out())]
        self._one, self._function = Evaluator(function), function

    @cached_property
    def _chunk(self) -> Evaluator:
        function = self._function
        return Evaluator(_MAPPED.get(function, lambda: (function, function.map(_CHUNK)))[1])

    def __call__(self, *columns: FloatArray) -> list[FloatArray]:
        """Return arrays of shape (size of the output, T) for arrays (size of the input, T)."""
        count = columns[0].shape[1]
        if count == 1:
            outputs = self._one(*(column[:, 0] for column in columns))
            return [output.reshape(-1, 1).copy() for output in outputs]
        results: list[FloatArray] = [np.empty((rows, count)) for rows in self._rows]
        for start in range(0, count, _CHUNK):
            end = min(start + _CHUNK, count)
            width = 1 if start + 1 == count else _CHUNK
            if width == 1:
                outputs = self._one(*(column[:, start] for column in columns))
            else:
                some: Any = slice(start, end)
                if end - start < width:
                    some = np.minimum(np.arange(start, start + width), count - 1)
                outputs = self._chunk(*(column[:, some] for column in columns))
            for result, output in zip(results, outputs, strict=True):
                result[:, start:end] = output.reshape(len(result), width, order="F")[
                    :, : end - start
                ]
        return results


# Of each function, evaluators that no thread uses at the moment.
_IDLE = Prepared()


def evaluate_columns(function: ca.Function, *columns: FloatArray) -> list[FloatArray]:
    """Evaluate a function of column vectors at T of them; see :class:`ColumnEvaluator`."""
    _, idle = _IDLE.get(function, lambda: (function, deque[ColumnEvaluator]()))
    with _taken(idle, ColumnEvaluator, function) as evaluator:
        return evaluator(*columns)


@contextmanager
def _taken(
    idle: deque[_Value], make: Callable[[ca.Function], _Value], function: ca.Function
) -> Iterator[_Value]:
    """Yield an evaluator that no other thread has meanwhile: an idle one, or a new one."""
    try:
        evaluator = idle.pop()
    except IndexError:
        evaluator = make(function)
    yield evaluator
    idle.append(evaluator)


def _dense(sparsity: ca.Sparsity) -> FloatArray:
    if not sparsity.is_dense():
        raise ValueError(f"the function has a sparse argument {sparsity.dim()}, expected dense")
    rows, columns = sparsity.shape
    # CasADi stores by columns; a single column is a plain vector here.
    return np.zeros(rows) if columns == 1 else np.zeros((rows, columns), order="F")


def _memory(array: FloatArray) -> memoryview:
    """Return the memory of an array as CasADi reads it; no copy."""
    return memoryview(array.ravel(order="K").data)
