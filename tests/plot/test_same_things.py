"""Pictures, views and films take what the package returns."""

import numpy as np
import pytest
from matplotlib import pyplot as plt

import tenscontrol as tc


@pytest.fixture(scope="module")
def shown():
    prism = tc.prism()
    model = tc.Model(prism, strings=tc.LinearStrings(stiffness=100.0))
    rest = tc.prestress(prism, force_density=10.0)
    target = tc.shape_target(
        model, tc.Height(0.95, top=[0, 1, 2], bottom=[3, 4, 5]), force_density=10.0
    )
    path = tc.shape_path(model, rest, target, duration=0.2, step=0.05)
    run = tc.simulate(model, 0.2, rest_length=tc.to_rest_length(model, rest), step=1e-2)
    return {"structure": prism, "prestress": rest, "target": target, "path": path, "run": run}


@pytest.mark.parametrize("name", ["structure", "prestress", "target", "path", "run"])
def test_a_picture_and_a_view_of_each(shown, name):
    each = shown[name]
    drawing, view = tc.plot.structure(each), tc.plot.view(each)
    last = {"path": -1, "run": -1}.get(name, 0)
    np.testing.assert_array_equal(drawing.structure.bars, view.members.bars)
    assert (drawing.colorbar is None) == (view.force_density is None) == (name == "structure")
    assert view.nodes[:, :, last].shape == (3, 6)
    plt.close(drawing.ax.figure)


def test_a_path_is_drawn_in_the_shape_of_a_time(shown):
    path = shown["path"]
    first = tc.plot.structure(path, time=0.0)
    np.testing.assert_allclose(first.nodes.get_data_3d(), path.nodes[:, :, 0])
    plt.close(first.ax.figure)
    with pytest.raises(ValueError, match=r"time is 9 s, expected 0 to .* as the path"):
        tc.plot.structure(path, time=9.0)


def test_a_film_of_a_path_and_one_of_a_run_with_its_target(shown, tmp_path):
    for name, target in (("path", None), ("run", shown["target"])):
        file = tmp_path / f"{name}.gif"
        tc.plot.animate(shown[name], file, fps=10, dpi=20, target=target)
        assert file.read_bytes()[:3] == b"GIF"
