"""A run as a dataset of xarray, which labels axes and units."""

from __future__ import annotations

from math import prod
from typing import Any

from xarray import Dataset

from tenscontrol._version import __version__

# A table of more rows is not what anybody means.
_MOST_ROWS = 20_000_000


class RunDataset(Dataset):  # type: ignore[no-untyped-call]  # of xarray
    """A dataset that makes no table of every node with every string, bar and sample."""

    __slots__ = ()

    def to_dataframe(self, dim_order: Any = None) -> Any:
        """Return a frame of pandas, one row for each combination of the dimensions.

        Raises
        ------
        ValueError
            If that is more than 20 million rows.
        """
        rows = prod(self.sizes.values())
        if rows > _MOST_ROWS:
            raise ValueError(
                f"to_dataframe would make {rows:.3g} rows, each combination of "
                f"{', '.join(map(str, self.sizes))}. run.to_pandas() has one row a time; or select "
                "variables of the same dimensions first: dataset[['force_density', 'tension']]"
            )
        return super().to_dataframe(dim_order)


def dataset(run: Any) -> RunDataset:
    """Return a run as a dataset; see :meth:`Trajectory.to_xarray`."""
    d = run.structure.dimension
    turns = ("axis",) if d == 3 else ()
    angular = run.angular_momentum if turns else run.angular_momentum[0]
    entries = {
        "nodes": (("axis", "node", "time"), run.nodes, "m"),
        "velocities": (("axis", "node", "time"), run.velocities, "m/s"),
        "force_density": (("string", "time"), run.force_density, "N/m"),
        "tension": (("string", "time"), run.tension, "N"),
        "kinetic_energy": (("time",), run.kinetic_energy, "J"),
        "potential_energy": (("time",), run.potential_energy, "J"),
        "momentum": (("axis", "time"), run.momentum, "kg m/s"),
        "angular_momentum": ((*turns, "time"), angular, "kg m2/s"),
        "bar_length_error": (("bar", "time"), run.bar_length_error, "m"),
    }
    if run.rest_length is not None:
        entries["rest_length"] = ("string", "time"), run.rest_length, "m"
    coordinates = {
        "time": ("time", run.time, {"units": "s"}),
        "axis": list("xyz"[:d]),
        "string_group": ("string", list(run.structure.string_groups)),
    }
    if run.control is not None:
        unit = "N/m" if run.rest_length is None else "m"
        entries["command"] = ("winch", "sample"), run.control.command, unit
        entries["applied"] = ("winch", "sample"), run.control.applied, unit
        coordinates["sample_time"] = ("sample", run.control.time, {"units": "s"})
        coordinates["status"] = ("sample", [str(status) for status in run.control.status])
    about = {"method": run.method, "tenscontrol": __version__}
    variables = {
        name: (dims, values, {"units": unit}) for name, (dims, values, unit) in entries.items()
    }
    return RunDataset(variables, coordinates, about)
