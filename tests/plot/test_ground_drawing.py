"""The ground, what presses on it, and the figure of contacts."""

import casadi as ca
import numpy as np
import pytest
from matplotlib.patches import Polygon
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import tenscontrol as tc
from tenscontrol.plot.ground_drawing import plane_border

LAW = {"stiffness": 5e3, "damping": 0.3, "friction": 0.5}


def dropped(structure, laws, duration=0.2, force_density=100.0, **options):
    rest = tc.prestress(structure, force_density=force_density)
    model = tc.Model(structure, gravity=9.81, ground=laws)
    gamma = rest.force_density
    return tc.simulate(model, duration, force_density=gamma, tolerance=1e-8, **options)


@pytest.fixture(scope="module")
def run(prism):
    return dropped(prism, tc.Ground(height=-0.1, **LAW))


@pytest.fixture(scope="module")
def flat_run():
    d_bar = tc.library.d_bar()
    low = float((np.array([-0.3, 1.0]) / np.hypot(0.3, 1) @ d_bar.nodes).min())
    return dropped(d_bar, tc.Ground(normal=[-0.3, 1.0], height=low - 0.05, **LAW))


def test_a_run_is_drawn_on_its_ground(run):
    drawing = tc.plot.structure(run)
    (patch,) = drawing.ground
    assert isinstance(patch, Poly3DCollection)
    assert drawing.ax.get_zlim()[0] <= -0.1
    assert "ground" in [text.get_text() for text in drawing.ax.get_legend().get_texts()]


def test_nodes_that_press_are_marked_at_their_time(run):
    pressed = tc.plot.structure(run, time=0.17).touching
    k = int(np.abs(run.time - 0.17).argmin())
    nodes = run.contacts.node[run.contacts.normal_force[:, k] > 0]
    assert len(nodes) == 3
    np.testing.assert_array_equal(np.array(pressed.get_data_3d()), run.nodes[:, nodes, k])
    in_flight = tc.plot.structure(run, time=0.05).touching
    assert np.size(in_flight.get_data_3d()) == 0


def test_marks_move_with_the_drawing(run):
    drawing = tc.plot.structure(run, time=0.05)
    drawing.update(run.nodes[:, :, -1], touching=[3, 5])
    shown = np.array(drawing.touching.get_data_3d())
    np.testing.assert_array_equal(shown, run.nodes[:, [3, 5], -1])
    drawing.update(run.nodes[:, :, -1])
    assert np.size(drawing.touching.get_data_3d()) == 0


def test_the_border_of_a_patch_lies_in_the_plane_and_in_the_box():
    normal, box = np.array([1.0, 0.2, 0.3]), np.array([[-1, 1], [-2, 2], [0, 3]], float)
    law = tc.Ground(normal=normal, height=0.2, **LAW)
    border = plane_border(law, box)
    np.testing.assert_allclose(border @ law.normal, 0.2, atol=1e-12)
    assert ((border >= box[:, 0] - 1e-12) & (border <= box[:, 1] + 1e-12)).all()
    assert len(border) == 5
    assert len(plane_border(tc.Ground(normal=normal, height=-20.0, **LAW), box)) == 0


def test_in_the_plane_what_is_beneath_is_filled(flat_run):
    drawing = tc.plot.structure(flat_run)
    filled, edge = drawing.ground
    assert isinstance(filled, Polygon)
    (law,) = flat_run.ground
    np.testing.assert_allclose(law.normal @ np.array(edge.get_data()), law.height, atol=1e-12)
    inside = filled.get_xy() @ law.normal
    assert (inside <= law.height + 1e-9).all()


def test_a_curved_ground_and_a_wall(prism):
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    hills = ca.Function("h", [x, y], [0.1 * ca.sin(4 * x) - 0.15])
    laws = [tc.Ground(height=hills, **LAW), tc.Ground(normal=[1, 0, 0], height=-1.5, **LAW)]
    drawing = tc.plot.structure(dropped(prism, laws, 0.01))
    assert len(drawing.ground) >= 1


def test_without_ground_nothing_is_added(slack_run, prism):
    assert tc.plot.structure(slack_run).ground == ()
    assert tc.plot.structure(slack_run).touching is None
    assert tc.plot.structure(prism).ground == ()


def test_a_faint_run_has_no_ground(run):
    assert tc.plot.structure(run, faint=True).ground == ()


@pytest.mark.parametrize("which", ["run", "flat_run"])
def test_animations_show_the_ground(which, request, tmp_path):
    path = tc.plot.animate(request.getfixturevalue(which), tmp_path / "drop.gif", fps=10)
    assert path.stat().st_size > 0


def test_contacts_are_drawn(run):
    panels = tc.plot.contacts(run)
    assert list(panels) == ["normal_force", "depth", "touch", "work", "balance"]
    (line,) = panels["normal_force"].lines["node 3"]
    np.testing.assert_array_equal(line.get_ydata(), run.contacts.normal_force[0])
    (bar,) = panels["touch"].lines["node 3"]
    assert bar.get_xdata()[0] == run.contacts.begin[run.contacts.touch == 0][0]
    (lost,) = panels["work"].lines["lost by damping"]
    np.testing.assert_allclose(lost.get_ydata(), run.contacts.damping_work.sum(axis=0))
    (change,) = panels["balance"].lines["all energy"]
    assert np.abs(change.get_ydata()).max() < 1e-4 * run.kinetic_energy.max()


def test_many_contacts_share_a_name():
    ball = tc.library.six_bar_ball()
    law = tc.Ground(height=float(ball.nodes[2].max()) + 1e-3, stiffness=100.0)
    limits = tc.HealthLimits(penetration=None)
    run = dropped(ball, law, 0.01, force_density=20.0, limits=limits)
    panels = tc.plot.contacts(run)
    assert len(run.contacts.node) == 12
    assert len(panels["depth"].lines) == 7
    assert len(panels["depth"].lines["others"]) == 6


def test_the_energy_panel_shows_what_was_lost(run, slack_run):
    assert "lost at the ground" in tc.plot.health(run)["energy"].lines
    assert "lost at the ground" not in tc.plot.health(slack_run)["energy"].lines


def test_a_run_without_ground_is_refused(slack_run):
    with pytest.raises(ValueError, match="run has no ground"):
        tc.plot.contacts(slack_run)
