"""What can be viewed, and what is refused."""

import numpy as np
import pytest

import tenscontrol as tc
from tests.control.test_control_input import short_path


def test_a_notebook_shows_a_run_a_path_and_modes_as_a_view_does(free_run, plant):
    for shown in (free_run, short_path(), tc.modes(plant)):
        figure = shown._repr_mimebundle_()["application/vnd.plotly.v1+json"]
        assert figure == tc.plot.view(shown).figure()


def test_a_structure_takes_a_force_density(prism):
    view = tc.plot.view(prism, force_density=5.0)
    np.testing.assert_array_equal(view.force_density, np.full((9, 1), 5.0))


def test_members_of_a_strength_are_coloured_by_force_over_strength(prism):
    steel = tc.sizing.materials["steel"]
    sized = tc.sections(prism, bars=steel, strings=steel, bar_radius=0.01, string_radius=0.001)
    rest = tc.prestress(sized.structure, force_density=100.0)
    run = tc.simulate(tc.Model(sized.structure), 0.05, force_density=rest.force_density, step=0.01)
    found = tc.strength(run, sized)
    view = tc.plot.view(found)
    np.testing.assert_allclose(view.share[9:], 1 / found.bar_margin)
    assert next(iter(view._spec()["colors"])) == view._spec()["shareName"] == "force over strength"
    drawing = tc.plot.utilization(found, time=0.02)
    np.testing.assert_allclose(drawing.bars.get_array(), 1 / found.bar_margin[:, 2])
    np.testing.assert_allclose(drawing.strings.get_array(), 1 / found.string_margin[:, 2])
    with pytest.raises(ValueError, match=r"time is 1 s, expected 0 to 0.05 s"):
        tc.plot.utilization(found, time=1.0)


def test_what_cannot_be_viewed_is_refused(prism, free_run):
    with pytest.raises(TypeError, match=r"shown is a int, expected a Structure, a Trajectory"):
        tc.plot.view(3)
    with pytest.raises(ValueError, match=r"force_density is given, but shown is Trajectory"):
        tc.plot.view(free_run, force_density=5.0)
    with pytest.raises(ValueError, match=r"force_density.* a string can only pull"):
        tc.plot.view(prism, force_density=-1.0)


def test_the_frame_of_a_notebook_holds_the_whole_page(prism):
    text = tc.plot.view(prism)._repr_html_()
    assert text.startswith('<iframe srcdoc="&lt;!DOCTYPE html&gt;')
    assert '"' not in text.split('srcdoc="', 1)[1].split('" width', 1)[0]
