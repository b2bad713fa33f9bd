"""The package as it is where no core was built."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch


@contextmanager
def without_core() -> Iterator[None]:
    """Run what is within on CasADi's virtual machine."""
    with patch("tenscontrol.integrate.core_scene.library", lambda: None):
        yield
