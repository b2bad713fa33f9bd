"""What is written runs in MuJoCo as the model does here."""

from xml.etree import ElementTree

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.accuracy.peers.rigid_bodies import NodeReader
from tenscontrol.exchange.kinematic_tree import KinematicTree
from tests.exchange.structures import library, others, thrown

mujoco = pytest.importorskip("mujoco", reason="MuJoCo comes with the extra test")


class Run:
    """A model of MuJoCo in its start."""

    def __init__(self, structure, text):
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data, self.reader = mujoco.MjData(self.model), NodeReader(self.model, structure)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)

    def go_on(self, duration):
        """Return nodes and velocities after so many seconds."""
        mujoco.mj_step(self.model, self.data, round(duration / self.model.opt.timestep))
        nodes, rates = self.reader.motion([self.reader.read(self.data)])
        return nodes[..., 0], rates[..., 0]


def exact(model, duration, **given):
    run = tc.simulate(model, duration, method="dop853", tolerance=1e-11, output_step=duration,
                      **given)  # fmt: skip
    return run.nodes[..., -1], run.velocities[..., -1]


def energy(model, nodes, velocities, rest):
    x = np.r_[
        nodes[:, model.structure.free].ravel("F"), velocities[:, model.structure.free].ravel("F")
    ]
    weight = model.constant_force
    return (
        float(model.kinetic_energy(x))
        + float(model.elastic_energy(x, rest))
        - (weight * nodes).sum()
    )


# Order of the error in the step, and the largest error at 0.5 ms, m.
STRUCTURES = {
    "six_bar_ball": (4, 1e-8),
    "class2_tower": (4, 1e-7),
    "arm": (4, 1e-8),
    "d_bar": (2, 1e-7),
}


@pytest.mark.parametrize("name", STRUCTURES)
def test_mujoco_moves_as_we_do_to_the_error_of_its_integrator(name):
    """Bars in a tree by RK4 to the fourth order; where a loop is closed to the second."""
    structure = library()[name]
    order, most = STRUCTURES[name]
    model = tc.Model(structure, strings=tc.LinearStrings(1e3), gravity=9.81)
    given = {"rest_length": 0.9 * structure.string_length(), "velocities": thrown(structure)}
    nodes, rates = exact(model, 0.1, **given)
    steps, errors = [2e-3, 1e-3, 5e-4], []
    for step in steps:
        found, speeds = Run(structure, tc.exchange.to_mujoco(model, step=step, **given)).go_on(0.1)
        errors.append(np.abs(found - nodes).max())
    fitted = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    # Before MuJoCo 4 quaternions were turned to the third order, which shows below 1e-8 m.
    assert order - (1.3 if order == 4 else 0.6) < fitted < order + 0.6
    assert errors[-1] < most
    assert np.abs(speeds - rates).max() < 1e3 * most
    energies = [
        energy(model, *at, given["rest_length"]) for at in ((found, speeds), (nodes, rates))
    ]
    assert energies[0] == pytest.approx(energies[1], rel=1e3 * most)
    length = np.linalg.norm(structure.bar_vectors(found), axis=0)
    np.testing.assert_allclose(length, structure.bar_length, rtol=1e-12 if order == 4 else 1e-6)


def test_momentum_of_a_thrown_ball_is_that_of_the_model():
    ball = library()["six_bar_ball"]
    model = tc.Model(ball, strings=tc.LinearStrings(1e3))
    rest, V = 0.9 * ball.string_length(), thrown(ball)
    text = tc.exchange.to_mujoco(model, rest_length=rest, velocities=V, step=5e-4)
    before = np.r_[ball.nodes.ravel("F"), V.ravel("F")]
    after = np.concatenate([part.ravel("F") for part in Run(ball, text).go_on(0.2)])
    for first, last in zip(model.momentum(before), model.momentum(after), strict=True):
        np.testing.assert_allclose(np.array(last), np.array(first), rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("payload", tc.LinearStrings(1e3, 2.0)),
        ("rollers", tc.ElasticStrings(1e3)),
        ("clustered", tc.LinearStrings(1e3)),
        ("planar_roller", tc.LinearStrings(1e3)),
        ("cut", tc.ElasticStrings(50.0, 0.1)),
    ],
)
@pytest.mark.parametrize("actuators", ["none", "rest_length"])
def test_payloads_rollers_clusters_and_rigidity(name, law, actuators):
    structure = others()[name]
    model = tc.Model(structure, strings=law, gravity=9.81)
    given = {"rest_length": 0.9 * structure.string_length(), "velocities": thrown(structure)}
    text = tc.exchange.to_mujoco(model, step=2.5e-4, actuators=actuators, **given)
    found, rates = Run(structure, text).go_on(0.02)
    nodes, velocities = exact(model, 0.02, **given)
    switches = name in ("clustered", "planar_roller")  # slack is not located, loops are springs
    np.testing.assert_allclose(found, nodes, rtol=0, atol=1e-5 if switches else 1e-8)
    np.testing.assert_allclose(rates, velocities, rtol=0, atol=1e-3 if switches else 1e-5)


@pytest.mark.parametrize("law", [tc.LinearStrings(1e3), tc.ElasticStrings(1e3)])
def test_actuators_move_strings_as_our_rest_lengths_do(law):
    """After 50 ms a third of the strings are wound in, and some paid out until they are slack."""
    ball = library()["six_bar_ball"]
    model = tc.Model(ball, strings=law, gravity=9.81)
    first = 0.9 * ball.string_length()
    then = first * np.where(np.arange(24) % 3 == 0, 0.9, np.where(np.arange(24) % 5 == 0, 1.4, 1))
    run = Run(ball, tc.exchange.to_mujoco(model, rest_length=first, actuators="rest_length",
                                          step=1e-4))  # fmt: skip
    run.go_on(0.05)
    run.data.ctrl[:] = then if isinstance(law, tc.LinearStrings) else 1 / then
    found, _ = run.go_on(0.05)
    nodes, velocities = exact(model, 0.05, rest_length=first)
    nodes, _ = exact(model, 0.05, rest_length=then, nodes=nodes, velocities=velocities)
    assert np.abs(nodes - ball.nodes).max() > 0.05
    np.testing.assert_allclose(found, nodes, rtol=0, atol=1e-6)
    assert run.data.actuator_force.max() == 0  # slack strings do not push


@pytest.mark.parametrize("actuators", ["none", "force_density", "tension"])
def test_force_densities_are_springs_controls_and_tensions(actuators):
    structure = library()["d_bar"]
    model = tc.Model(structure)
    gamma = np.array([30.0, 50.0])
    text = tc.exchange.to_mujoco(model, force_density=gamma, actuators=actuators, step=1e-4)
    run = Run(structure, text)
    mujoco.mj_forward(run.model, run.data)
    pulls = run.data.qfrc_passive + run.data.qfrc_actuator
    springs = Run(structure, tc.exchange.to_mujoco(model, force_density=gamma))
    mujoco.mj_forward(springs.model, springs.data)
    np.testing.assert_allclose(pulls, springs.data.qfrc_passive, atol=1e-12)
    if actuators == "tension":
        np.testing.assert_allclose(run.data.ctrl, gamma * structure.string_length())
    else:
        nodes, _ = exact(model, 0.05, force_density=gamma)
        np.testing.assert_allclose(run.go_on(0.05)[0], nodes, rtol=0, atol=1e-8)


def test_constant_loads_push_on_nodes():
    structure = others()["payload"]
    load = np.random.default_rng(0).normal(size=(3, 12))
    model = tc.Model(structure, tc.LinearStrings(1e3), external_force=True, gravity=[0, 1, -9])
    given = {"rest_length": 0.9 * structure.string_length(), "external_force": load}
    found, _ = Run(structure, tc.exchange.to_mujoco(model, **given)).go_on(0.05)
    np.testing.assert_allclose(found, exact(model, 0.05, **given)[0], rtol=0, atol=1e-7)


def test_a_planar_structure_bounces_on_the_ground_as_we_do():
    """Its corner meets the ground at 2 m/s; MuJoCo's least impedance is the difference."""
    d_bar = library()["d_bar"]
    ground = tc.Ground(5e3, height=float(d_bar.nodes[1].min()) - 0.02)
    model = tc.Model(d_bar, tc.LinearStrings(1e3), gravity=9.81, ground=ground)
    falling = np.array([[0.0], [-2.0]]) * np.ones(4)
    given = {"rest_length": 0.8 * d_bar.string_length(), "velocities": falling}
    text = tc.exchange.to_mujoco(model, step=1e-4, **given)
    found, _ = Run(d_bar, text).go_on(0.1)
    run = tc.simulate(model, 0.1, output_step=1e-3, **given)
    assert run.nodes[1].min() < ground.height - 0.01
    assert run.velocities[1, :, -1].mean() > 0.3
    np.testing.assert_allclose(found, run.nodes[..., -1], rtol=0, atol=1e-3)


@pytest.mark.parametrize("name", ["spine", "geiger_dome", "stedy_arm", "wheel"])
def test_contacts_have_the_inverse_weights_of_mujoco(name):
    structure = library()[name]
    tree = KinematicTree.of(structure, structure.nodes)
    text = tc.exchange.to_mujoco(tc.Model(structure), force_density=1.0)
    compiled = mujoco.MjModel.from_xml_string(text)
    theirs = [compiled.body(body.name).invweight0[0] for body in tree.bodies]
    np.testing.assert_allclose(tree.inverse_weights(), theirs, rtol=1e-9)
    assert compiled.nv == sum(joint.freedoms for body in tree.bodies for joint in body.joints)
    assert compiled.neq == len(tree.loops)


def test_the_text_names_nodes_bars_and_strings():
    ball = library()["six_bar_ball"]
    text = tc.exchange.to_mujoco(tc.Model(ball), force_density=10.0)
    root = ElementTree.fromstring(text)
    assert {site.get("name") for site in root.iter("site") if site.get("name")} == {
        "space", *(f"n{i}" for i in range(12))
    }  # fmt: skip
    assert [each.get("name") for each in root.iter("spatial")] == [f"s{i}" for i in range(24)]
    assert len(root.findall("worldbody/body/freejoint")) == 0  # a joint of type free


PRISM = tc.prism()
SPRUNG = tc.Model(PRISM, strings=tc.LinearStrings(100.0))
LADDER = tc.Structure(
    [[0.0, 1.0], [1.0, 0.0]], [[0, 1]], np.zeros((0, 2), int), 1.0, fixed=[(0, "x"), (1, "y")]
)


def on(ground):
    return tc.Model(PRISM, ground=ground)


@pytest.mark.parametrize(
    ("model", "given", "message"),
    [
        (SPRUNG, {}, "neither rest_length nor force_density"),
        (SPRUNG, {"rest_length": 0.8, "force_density": 1.0}, "both rest_length and force_density"),
        (SPRUNG, {"force_density": 1.0, "actuators": "rest_length"}, "give rest_length"),
        (SPRUNG, {"rest_length": 0.8, "actuators": "motor"}, "actuators is 'motor'"),
        (SPRUNG, {"rest_length": 0.8, "integrator": "rk5"}, "integrator is 'rk5'"),
        (SPRUNG, {"rest_length": 0.8, "step": 0.0}, "step is 0.0"),
        (SPRUNG, {"rest_length": np.ones(8)}, "rest_length has shape"),
        (tc.Model(PRISM), {"rest_length": 0.8}, "the model has no string law"),
        (tc.Model(LADDER), {}, "node 1 is on a roller"),
        (on(tc.dynamics.HertzGround(1e3)), {"force_density": 1.0}, "not HertzGround"),
        (on(tc.Ground(1e3, friction=0.5)), {"force_density": 1.0}, "give it damping"),
        (SPRUNG, {"rest_length": 0.8, "nodes": 1.1 * PRISM.nodes}, "in nodes, bar 0 has length"),
    ],
)
def test_what_mujoco_has_not_is_refused(model, given, message):
    with pytest.raises(ValueError, match=message):
        tc.exchange.to_mujoco(model, **given)


def wound_here(model, plant, lengths, start, sample=0.02):
    """Nodes after inputs (samples, m), m, each held for a sample."""
    nodes, rates = start, np.zeros_like(start)
    for inputs in lengths:
        held = plant.actuation.strings(inputs)
        nodes, rates = exact(model, sample, nodes=nodes, velocities=rates, rest_length=held)
    return nodes


@pytest.mark.parametrize("law", [tc.LinearStrings(1e3, 2.0), tc.ElasticStrings(5e2)])
@pytest.mark.parametrize("ganged", [False, True])
def test_driven_strings_have_actuators_and_passive_ones_are_springs(law, ganged):
    """Motions of both under the same rest lengths; a gang is set by coefficients of the model."""
    ball = library()["six_bar_ball"]
    model = tc.Model(ball, strings=law)
    at = tc.prestress(ball, min_force_density=100.0)  # taut throughout
    winches = list(range(22, -1, -2))
    if ganged:
        winches = {f"motor_{k}": {4 * k: 1.0, 4 * k + 2: -0.5} for k in range(6)}
    plant = tc.linearize(model, at, input="rest_length", actuated=winches)
    actuation, driven = plant.actuation, plant.actuation.driven.tolist()
    given = {"rest_length": plant.rest_length, "actuators": "rest_length", "step": 2.5e-4}
    order = driven if ganged else winches
    text = tc.exchange.to_mujoco(model, actuated=actuation, **given)
    run = Run(ball, text)
    assert run.model.nu == 12
    change = np.random.default_rng(0).uniform(-0.03, 0.03, (3, len(actuation.lead)))
    lengths = plant.equilibrium_input + change
    np.testing.assert_allclose(run.data.ctrl, by_law(law, plant.rest_length[order]))
    for inputs in lengths:
        values = actuation.strings(inputs)[order]
        if ganged:
            of, ratio, offset = (
                run.model.numeric(f"winch_{name}").data for name in ("input", "ratio", "offset")
            )
            values = offset + ratio * inputs[of.astype(int)]
        run.data.ctrl[:] = by_law(law, values)
        nodes, _ = run.go_on(0.02)
    assert np.abs(nodes - ball.nodes).max() > 1e-3
    np.testing.assert_allclose(nodes, wound_here(model, plant, lengths, ball.nodes), atol=1e-6)


def by_law(law, lengths):
    """What an actuator takes: rest lengths, or their inverses."""
    return lengths if isinstance(law, tc.LinearStrings) else 1 / lengths


@pytest.mark.parametrize("kind", ["tension", "force_density"])
def test_passive_strings_keep_what_they_have_under_forces_of_the_driven(kind, prism):
    model = tc.Model(prism, strings=tc.LinearStrings(100.0))
    text = tc.exchange.to_mujoco(model, rest_length=0.8, actuators=kind, actuated=["vertical"])
    root = ElementTree.fromstring(text)
    names = [each.get("name") for each in root.iter("general")]
    assert names == ["s6", "s7", "s8"]
    springs = [each.get("name") for each in root.iter("spatial") if each.get("stiffness")]
    assert springs == [f"s{k}" for k in range(6)]
    with pytest.raises(ValueError, match="actuated is given, but actuators is 'none'"):
        tc.exchange.to_mujoco(model, rest_length=0.8, actuated=[0])
