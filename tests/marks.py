"""Marks of tests that do not run everywhere."""

import pytest

from tenscontrol.core.library import library

needs_core = pytest.mark.skipif(library() is None, reason="installed without a compiler")
