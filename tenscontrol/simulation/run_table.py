"""A run as a table: a line a time, as CSV or for pandas."""

from __future__ import annotations

import csv
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.files import write_file
from tenscontrol.simulation.control_record import ControlRecord

if TYPE_CHECKING:
    from pandas import DataFrame


def _commanding(control: ControlRecord, time: FloatArray) -> IntArray:
    """Return the sample whose command acted in the step to each time."""
    slack = 1e-9 * (control.sample_time or 0.0)
    return np.maximum(np.searchsorted(control.time, time - slack, side="left") - 1, 0)


def run_table(run: Any) -> tuple[list[str], FloatArray]:
    """Return the head, and a line a time, of time, nodes, strings and commands of a run."""
    d, n, count = run.nodes.shape
    head, columns = ["time [s]"], [run.time[None]]
    head += [f"node {i} {axis} [m]" for i in range(n) for axis in "xyz"[:d]]
    columns.append(run.nodes.swapaxes(0, 1).reshape(-1, count))
    strings = [("force density [N/m]", run.force_density), ("tension [N]", run.tension)]
    if run.rest_length is not None:
        strings.append(("rest length [m]", run.rest_length))
    for label, values in strings:
        head += [f"string {i} {label}" for i in range(len(values))]
        columns.append(values)
    if run.control is not None:
        label = "command [N/m]" if run.rest_length is None else "command [m]"
        head += [f"winch {i} {label}" for i in range(len(run.control.command))]
        columns.append(run.control.command[:, _commanding(run.control, run.time)])
    return head, np.vstack(columns).T


def write_table(run: Any, path: object) -> Path:
    """Write the table of a run as CSV; see :meth:`Trajectory.to_csv`."""
    file, (head, rows) = validation.file_path("path", path), run_table(run)
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows.tolist())
    return write_file(file, text.getvalue())


def data_frame(run: Any) -> DataFrame:
    """Return the table of a run as a frame of pandas; see :meth:`Trajectory.to_pandas`."""
    try:
        import pandas as pd
    except ImportError as error:
        raise ImportError(
            "to_pandas needs the package pandas, which is not installed: "
            "pip install 'tenscontrol[pandas]'"
        ) from error
    head, rows = run_table(run)
    return pd.DataFrame(rows[:, 1:], pd.Index(rows[:, 0], name=head[0]), head[1:])
