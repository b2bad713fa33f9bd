"""Tipping over an edge: statics by another route, gradients, the turn onto a face, and the gait."""

import pickle
from functools import cache

import casadi as ca
import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.plant import set_down
from tenscontrol.shape import RollingGait, TippingError, tipping_path
from tenscontrol.shape.faces import lowest_face
from tenscontrol.shape.ground_roughness import roughness
from tenscontrol.shape.rolling import _rolled
from tenscontrol.shape.tipping import TippingPlanner

FACE, REST = [0, 4, 8], 0.55
WINCHES = tc.Winches(rate=0.2, shortest=0.35, longest=0.8, ramp=True)


def uphill(degrees):
    angle = np.radians(degrees)
    return np.array([np.cos(angle), 0.0, np.sin(angle)])


@cache
def ball(degrees=0.0, **changes):
    """The six-bar ball on ground that rises along x."""
    normal = np.cross(uphill(degrees), [0.0, 1.0, 0.0])
    settings = {"stiffness": 5e3, "damping": 0.5, "friction": 0.5, "slip_speed": 0.05}
    return tc.Model(
        tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5),
        strings=tc.LinearStrings(stiffness=1000.0, damping=10.0),
        gravity=9.81,
        ground=tc.Ground(**(settings | changes), normal=normal),
    )


OTHERS = {
    "prism": (lambda: tc.prism(bar_mass=0.5), [3, 4, 5], 60.0),
    "X in the plane": (tc.library.snelson_x, [0, 1], 60.0),
    "twelve bars": (
        lambda: tc.library.twelve_bar_ball(1.0, bar_mass=0.1), [10, 11, 16, 21], 120.0,
    ),
}  # fmt: skip


@cache
def scene(name):
    """A model, rest lengths, feet, nodes and a direction."""
    if name not in OTHERS:
        degrees = 5.0 if name == "ball on a slope" else 0.0
        model = ball(degrees)
        return model, REST, FACE, set_down(model, FACE), uphill(degrees)
    make, feet, level = OTHERS[name]
    structure = make()
    strings, ground = tc.LinearStrings(stiffness=1000.0), tc.Ground(stiffness=5e3)
    model = tc.Model(structure, strings=strings, gravity=9.81, ground=ground)
    rest = tc.prestress(structure, min_force_density=level).force_density
    wound = tc.to_rest_length(model, structure.nodes, rest).rest_length
    return model, wound, feet, set_down(model, feet), np.eye(structure.dimension)[0]


@cache
def path(name):
    model, rest, feet, nodes, direction = scene(name)
    return tipping_path(model, rest, feet, direction, nodes=nodes)


@pytest.mark.parametrize("name", ["ball", "ball on a slope", *OTHERS])
class TestPath:
    def test_it_leads_over_the_edge(self, name):
        model, *_, direction = scene(name)
        found, size = path(name), np.ptp(model.structure.nodes, axis=1).max()
        assert found.margin[0] < 0
        assert found.margin[-1] >= 0.02 * size
        assert np.all(np.diff(found.margin) > 0)
        assert np.abs(np.diff(found.rest_length)).max() <= 0.01 * size * (1 + 1e-12)
        assert len(found.edge) == model.structure.dimension - 1
        assert found.outward @ direction > 0.4

    def test_the_margin_is_that_of_the_moment_of_gravity(self, name):
        model, found = scene(name)[0], path(name)
        weight = model.constant_force
        for nodes, margin in zip(np.moveaxis(found.nodes, 2, 0), found.margin, strict=True):
            arms = nodes - nodes[:, found.edge[:1]]
            moment = weight[-1] @ arms[0]
            if len(nodes) == 3:
                along = nodes[:, found.edge[1]] - nodes[:, found.edge[0]]
                moment = np.cross(arms.T, weight.T).sum(axis=0) @ along
                moment /= np.linalg.norm(along[:2])
            assert abs(margin) == pytest.approx(abs(moment / weight.sum()), abs=1e-12)

    def test_feet_that_need_no_friction_rest_where_they_are_pinned_too(self, name):
        model, _, feet, *_ = scene(name)
        given, found = model.structure, path(name)
        weight = model.constant_force.sum(axis=1)
        for k in (0, len(found.margin) // 2, -1):
            shape = found.nodes[:, :, k]
            pinned = tc.Structure(shape, given.bars, given.strings, given.bar_mass, fixed=feet)
            held = tc.Model(pinned, strings=model.strings, gravity=9.81)
            rest = tc.equilibrium(held, rest_length=found.rest_length[:, k])
            assert np.abs(rest.structure.nodes - shape).max() < 1e-6
            forces = -forces_of_members(rest) - model.constant_force
            assert forces[:, feet].sum(axis=1) == pytest.approx(-weight, abs=1e-6)
            rear = np.setdiff1d(found.feet, found.edge)
            lifts = model.ground[0].up(len(shape)) @ forces[:, rear].sum(axis=1) < 0
            assert lifts == (found.margin[k] > 0)

    def test_the_gradient_is_that_of_differences(self, name):
        model, rest, feet, nodes, _ = scene(name)
        planner = TippingPlanner(model, rest, None, 0.0)
        at = np.array(feet)
        edge = next(iter(planner.edges(nodes, at)))

        def margin(home):
            planner.home = home
            planner.start(nodes, at, edge)
            return planner.margin

        home = planner.home
        margin(home)
        slope = planner._uphill()
        for i in (0, 2, len(home) - 1):
            step = 1e-5 * np.eye(len(home))[i]
            assert slope[i] == pytest.approx(
                (margin(home + step) - margin(home - step)) / 2e-5, abs=1e-7
            )

    def test_a_rigid_shape_rolls_onto_the_next_face(self, name):
        model, rest, feet, nodes, _ = scene(name)
        planner = TippingPlanner(model, rest, None, 0.0)
        up = model.ground[0].up(len(nodes))
        for edge, over in planner.edges(nodes, np.array(feet)).items():
            moved = _rolled(nodes, np.array(feet), edge, up)
            landed, level = lowest_face(moved, -up, 0.02)
            assert level > 0.999
            assert set(edge) < set(landed)
            assert np.abs(up @ moved[:, landed]).max() < 0.03
            assert (up @ moved).min() > -1e-12
            assert over @ (moved - nodes).mean(axis=1) > 0
            apart = [np.linalg.norm(each[:, :, None] - each[:, None], axis=0)
                     for each in (nodes, moved)]  # fmt: skip
            assert apart[0] == pytest.approx(apart[1], abs=1e-12)


def forces_of_members(rest):
    """Return the forces of strings and bars on all nodes, N."""
    structure, forces = rest.structure, np.zeros(rest.structure.nodes.shape)
    for members, density in (
        (structure.strings, rest.force_density), (structure.bars, -rest.bar_force_density)
    ):  # fmt: skip
        for (i, j), each in zip(members, density, strict=True):
            pull = each * (structure.nodes[:, j] - structure.nodes[:, i])
            forces[:, i] += pull
            forces[:, j] -= pull
    return forces


class TestStanding:
    @pytest.mark.parametrize("degrees", [0.0, 5.0, -90.0])
    def test_every_face_comes_to_the_ground(self, degrees):
        model = ball(degrees)
        strings = {frozenset(each) for each in model.structure.strings.tolist()}
        faces = {
            frozenset((a, b, c)) for a in range(12) for b in range(a) for c in range(b)
            if {frozenset((a, b)), frozenset((b, c)), frozenset((a, c))} <= strings
        }  # fmt: skip
        assert len(faces) == 8
        for face in faces:
            nodes = set_down(model, list(face))
            above = model.ground[0].up(3) @ nodes
            assert np.flatnonzero(above < 1e-9).tolist() == sorted(face)
            assert above.min() == pytest.approx(0, abs=1e-12)
            assert np.linalg.norm(model.structure.bar_vectors(nodes), axis=0) == pytest.approx(1)

    def test_half_a_turn(self):
        model = tc.Model(tc.prism(), ground=tc.Ground(stiffness=1e3, height=0.5))
        for feet, turned in (([3, 4, 5], False), ([0, 1, 2], True)):
            nodes = set_down(model, feet)
            assert nodes[2, feet] == pytest.approx(0.5)
            mirror = np.linalg.det(nodes[:, :3] - nodes[:, 3:]) * np.linalg.det(
                model.structure.nodes[:, :3] - model.structure.nodes[:, 3:]
            )
            assert mirror >= -1e-12
            assert (nodes[2, 0] < nodes[2, 3]) == turned


class TestGait:
    def simulated(self, gait, duration=3.5):
        return tc.simulate(
            ball(), duration, set_down(ball(), FACE), controller=gait, winches=WINCHES,
            rest_length=REST, method="rk4", step=1e-3, project=True, error="none",
            output_step=0.05,
        )  # fmt: skip

    def test_one_step(self):
        gait = RollingGait(ball(), REST, uphill(0.0), 0.05, winches=WINCHES, steps=1)
        again = pickle.loads(pickle.dumps(gait))
        run = self.simulated(gait)
        (step,) = gait.made
        assert step.feet.tolist() == FACE
        assert set(step.edge) < set(step.landed)
        assert step.landed.tolist() != FACE
        moved = (run.nodes[:, :, -1] - run.nodes[:, :, 0]).mean(axis=1)
        assert moved[0] > 0.2
        assert run.control.winch_rate.max() <= 0.2 * (1 + 1e-9)
        assert run.control.applied[:, -1] == pytest.approx(REST)
        assert np.array_equal(self.simulated(again, 0.5).nodes, run.nodes[:, :, :11])

    @pytest.mark.parametrize("tabulated", [False, True])
    def test_on_a_mound_it_stands_on_the_lowest_face(self, tabulated):
        tilt = np.radians(6.0)
        turn = [[np.cos(tilt), 0, -np.sin(tilt)], [0, 1, 0], [np.sin(tilt), 0, np.cos(tilt)]]
        nodes = turn @ set_down(ball(), FACE) + 0.2 * uphill(90.0)[:, None]
        gait = RollingGait(
            ball(), REST, uphill(0.0), 0.05, winches=WINCHES, tabulated=tabulated
        )  # fmt: skip
        first, _ = (gait.command(0.05 * k, nodes, np.zeros((3, 12))) for k in range(2))
        assert np.all(first == REST)  # it may be about to fall
        second = gait.command(0.1, nodes, np.zeros((3, 12)))
        assert np.abs(second - REST).max() == pytest.approx(0.01)
        assert gait._planner.feet.tolist() == FACE

    def test_where_no_edge_can_be_passed_it_stays(self):
        winches = tc.Winches(rate=0.2, shortest=0.53, longest=0.57, ramp=True)
        gait = RollingGait(ball(), REST, uphill(0.0), 0.05, winches=winches)
        nodes = set_down(ball(), FACE)
        for k in range(80):
            value = gait.command(0.05 * k, nodes, np.zeros((3, 12)))
            assert np.all((value >= 0.53) & (value <= 0.57))
            gait.applied(value)
        assert gait.made == ()
        assert len(gait._vain) == 3

    def test_it_asks_again_after_a_reset(self):
        gait = RollingGait(ball(), REST, uphill(0.0), 0.05, winches=WINCHES, steps=1)
        nodes, still = set_down(ball(), FACE), np.zeros((3, 12))
        first = [gait.command(0.05 * k, nodes, still) for k in range(5)]
        gait.reset()
        again = [gait.command(0.05 * k, nodes, still) for k in range(5)]
        assert np.array_equal(first, again)
        assert not np.array_equal(first[0], first[-1])


class TestRoughGround:
    def test_roughness_is_measured_from_the_plane_that_fits_best(self):
        nodes = BALL.nodes + np.array([[3.0], [1.0], [0.0]])
        side = 4 * np.linspace(-0.5, 0.5, 21)
        for height, rough in (
            (0.3 * X - 0.1 * Y + 2.0, 0.0),
            (0.1 * X * Y, 0.1 * np.mean(side**2)),  # off a plane by 0.1 u v, from the centre
        ):
            ground = tc.Ground(1e3, height=ca.Function("h", [X, Y], [height]))
            model = tc.Model(BALL, STRINGS, ground=[tc.Ground(1e3, height=-1.0), ground])
            assert roughness(model, nodes, 1.0) == pytest.approx(rough, abs=1e-12)
        assert roughness(ball(), nodes, 1.0) == 0.0

    def test_a_run_on_rough_ground_is_warned_of(self):
        waves = ca.Function("h", [X, Y], [0.1 * ca.sin(8 * X) * ca.cos(8 * Y)])
        law = tc.Ground(5e3, damping=0.5, friction=0.5, slip_speed=0.05, height=waves)
        rough = tc.Model(ball().structure, ball().strings, gravity=9.81, ground=law)
        nodes = set_down(ball(), FACE) + 0.2 * uphill(90.0)[:, None]
        rolls = {"controller": gait(ball()), "rest_length": REST, "method": "rk4", "step": 1e-3}
        with pytest.warns(
            RuntimeWarning, match=r"off a plane by 0\.05 m .* 5\.0%.*larger structure"
        ):
            tc.simulate(rough, 0.01, nodes, **rolls)
        tc.simulate(ball(), 0.01, nodes, **rolls)  # warnings are errors


def tipped(model=None, rest=REST, feet=FACE, direction=(1.0, 0.0, 0.0), **changes):
    model = model or ball()
    return tipping_path(model, rest, feet, direction, nodes=set_down(ball(), FACE), **changes)


def gait(model, **changes):
    settings = {"rest_length": REST, "direction": uphill(0.0), "sample_time": 0.05}
    return RollingGait(model, **(settings | changes))


BALL = tc.library.six_bar_ball(1.0)
STRINGS = tc.LinearStrings(1000.0)
X, Y = ca.SX.sym("x"), ca.SX.sym("y")
DUNE = tc.Ground(stiffness=1e3, height=ca.Function("h", [X, Y], [0.1 * X * Y]))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tipped(feet=[0, 4]), r"feet are \[0, 4\], expected at least 3"),
        (lambda: tipped(feet=[0, 4, 12]), r"feet\[2\] is 12"),
        (
            lambda: tipped(feet=[0, 3, 8]),
            r"feet are \[0, 3, 8\], on which the structure does not stand",
        ),
        (lambda: tipped(rest=0.3, winches=WINCHES), r"rest_length\[0\] is 0.3 m"),
        (lambda: tipped(tc.Model(BALL, gravity=9.81)), "no string law"),
        (lambda: tipped(tc.Model(BALL, strings=STRINGS)), "no weight"),
        (lambda: gait(tc.Model(BALL, strings=STRINGS, gravity=9.81)), "0 contact laws"),
        (lambda: gait(tc.Model(BALL, STRINGS, gravity=9.81, ground=DUNE)), "is curved"),
        (lambda: set_down(ball(), [0, 3, 8]), r"feet are \[0, 3, 8\], but node \d+ would be lower"),
        (lambda: gait(ball(), direction=[0.0, 0.0, 0.0]), "direction"),
        (lambda: gait(ball(), steps=0), "steps is 0"),
        (lambda: gait(ball(5.0), tabulated=True), "tabulated is True, but .* is inclined"),
        (
            lambda: gait(ball(), tabulated=True, winches=tc.Winches(shortest=0.54, longest=0.56)),
            "finds no rest lengths that tip .* over any edge",
        ),
    ],
)
def test_what_does_not_fit_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_structure_with_supports_is_refused():
    prism = tc.prism()
    held = tc.Structure(prism.nodes, prism.bars, prism.strings, 1.0, fixed=[3])
    with pytest.raises(ValueError, match="has supports"):
        tipping_path(tc.Model(held, strings=STRINGS, gravity=1.0), 0.8, [3, 4, 5], uphill(0.0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"winches": tc.Winches(shortest=0.54, longest=0.56)}, "at the end of their range"),
        ({"clearance": 0.2}, "bars would come as near as 0.19.* clearance"),
        ({"margin": 2.0}, "margin is 2 m"),
    ],
)
def test_where_it_does_not_tip_the_way_there_is_told(changes, message):
    with pytest.raises(TippingError, match=message) as caught:
        tipped(**changes)
    reached = caught.value.reached
    assert reached.margin[-1] > reached.margin[0]
    assert reached.clearance >= changes.get("clearance", 0.0)
