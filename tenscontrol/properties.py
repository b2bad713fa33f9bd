"""Properties that are computed once for an object."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # checkers know that of functools as a property
    from functools import cached_property as cached_property  # noqa: TID251
else:

    class cached_property(functools.cached_property):  # noqa: N801, TID251
        """A property that is computed at its first use, without a lock.

        In Python 3.11 that of `functools` has one lock for all objects of a class: threads wait for
        one another, and a child that is forked while a thread is within waits for ever. Here
        threads may compute at once; all of them get what the first one found.
        """

        def __get__(self, instance: object, owner: type | None = None) -> object:
            """Return the value of an object, or the property itself for a class."""
            if instance is None:
                return self
            # What is found already is read without asking here.
            return instance.__dict__.setdefault(self.attrname, self.func(instance))
