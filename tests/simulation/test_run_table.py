"""Runs as tables of pandas, the same as the CSV; datasets do not explode into tables."""

import csv
import sys

import numpy as np
import pytest

import tenscontrol as tc
from tests.simulation.test_run_file import RUNS


@pytest.mark.parametrize("name", ["tower", "arm"])
def test_the_frame_is_the_csv(name, tmp_path):
    run = RUNS[name]()
    frame = run.to_pandas()
    with open(run.to_csv(tmp_path / "run.csv"), encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    assert [frame.index.name, *frame.columns] == head
    table = np.array(rows, float)
    np.testing.assert_array_equal(frame.index, table[:, 0])
    np.testing.assert_array_equal(frame.to_numpy(), table[:, 1:])


def test_a_table_of_each_node_with_each_string_is_refused(monkeypatch):
    run = tc.simulate(tc.Model(tc.prism()), 0.02, force_density=10.0, step=1e-3)
    data = run.to_xarray()
    rows = len(data.to_dataframe())
    assert rows == 3 * 6 * 9 * 3 * 21
    monkeypatch.setattr("tenscontrol.simulation.run_dataset._MOST_ROWS", rows - 1)
    with pytest.raises(ValueError, match=r"would make 1\.02e\+04 rows, .* run\.to_pandas\(\)"):
        data.to_dataframe()
    assert data[["tension", "force_density"]].to_dataframe().shape == (9 * 21, 3)


def test_without_pandas_it_says_what_to_install(monkeypatch):
    run = tc.simulate(tc.Model(tc.prism()), 0.01, force_density=10.0, step=1e-3)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"pip install 'tenscontrol\[pandas\]'"):
        run.to_pandas()
