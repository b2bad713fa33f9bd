"""The structures of the library, by name, in sizes for tests."""

from functools import partial

import tenscontrol as tc

_SIZES = {"prism_tower": {"stages": 2}, "cable_net": {"rows": 4, "columns": 5}}
_SIZES["net"] = {"rows": 4, "columns": 4, "spacing": 1.0, "node_mass": 0.1, "fixed": [0, 3, 12, 15]}

STRUCTURES = {
    name: partial(getattr(tc.library, name), **_SIZES.get(name, {})) for name in tc.library.__all__
}
