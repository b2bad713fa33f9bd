"""The command line of a benchmark: how much of it is run."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any


def options(page: str | None, arguments: Sequence[str] | None, **defaults: Any):
    """Return the options: each has its name, its default and the type of that.

    A tuple takes as many values as are given, False is a flag. ``page``, the docstring of the
    benchmark, is shown by ``--help``. Without ``arguments``, those of the process.
    """
    parser = argparse.ArgumentParser(
        description=page, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, default in defaults.items():
        if default is False:
            parser.add_argument(f"--{name}", action="store_true")
            continue
        several = isinstance(default, tuple)
        parser.add_argument(
            f"--{name}",
            type=type(default[0] if several else default),
            nargs="+" if several else None,
            default=default,
            help=f"default: {' '.join(map(str, default)) if several else default}",
        )
    return parser.parse_args(arguments)
