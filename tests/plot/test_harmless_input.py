"""What to draw, chosen by any collection or mask."""

import numpy as np

import tenscontrol as tc

PRISM = tc.prism()
REST = tc.prestress(PRISM, 17.3205)


def test_nodes_may_be_any_collection_or_mask():
    run = tc.simulate(tc.Model(PRISM), 0.05, force_density=0.9 * REST.force_density)
    known = list(tc.plot.trajectory(run, nodes=[1, 2])["coordinates"].lines)
    for nodes in ({1, 2}, [1, 2, 1], np.isin(np.arange(6), [1, 2]), np.array([[1], [2]])):
        assert list(tc.plot.trajectory(run, nodes=nodes)["coordinates"].lines) == known


def test_a_mode_that_is_named_twice_is_drawn_once():
    plant = tc.linearize(tc.Model(PRISM), REST)
    assert len(tc.plot.mode_shapes(plant, tc.modes(plant), which=[5, 5])) == 1


def test_a_run_on_ground_of_no_nodes_is_drawn():
    model = tc.Model(PRISM, gravity=9.81, ground=tc.Ground(1e4, nodes=[]))
    run = tc.simulate(model, 0.05, force_density=REST.force_density)
    assert "normal_force" in tc.plot.contacts(run)
    tc.plot.structure(run)
