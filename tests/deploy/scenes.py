"""Controllers that become C code, and a controller that asks two for every command."""

import warnings
from functools import cache

import numpy as np

import tenscontrol as tc
from tenscontrol.demo import tour as demo
from tests import coupled
from tests.known_structures import height_row

SAMPLE = 0.02
SAMPLES = 200

# Samples whose measurement is spoilt: one alone, three in a row, and one again.
SPOILT = (57, 120, 121, 122, 160)
ABSURD = (80, 81, 140)

WINCHES = tc.Winches(rate=0.5, shortest=0.1)
WINDING = tc.Winches(rate=0.5, shortest=0.1, substeps=10)


class Pair(tc.control.Controller):
    """Obeys one controller, and asks another for the same command.

    Every measurement in ``spoilt`` is handed to both with one entry that is not a number, every
    one in ``absurd`` with a bar twice as long.
    """

    def __init__(self, one, other, spoilt=SPOILT, absurd=ABSURD):
        super().__init__(one.plant, one.sample_time, *one.bounds)
        self.one, self.other, self.spoilt, self.absurd = one, other, spoilt, absurd
        self.reset()

    def reset(self):
        self.one.reset()
        self.other.reset()
        self.asked, self.told, self.answers, self.iterations = [], [], [], []

    def command(self, time, nodes, velocities):
        nodes, velocities = np.array(nodes), np.array(velocities)
        if len(self.answers) in self.spoilt:
            velocities[1, 2] = np.nan
        if len(self.answers) in self.absurd:
            start, end = self.plant.model.structure.bars[0]
            nodes[:, end] += nodes[:, end] - nodes[:, start]
        self.asked.append(np.r_[time, nodes.ravel(order="F"), velocities.ravel(order="F")])
        first, second = (each.command(time, nodes, velocities) for each in (self.one, self.other))
        self.answers.append((first, second))
        self.iterations.append(self.other.iterations)
        return first

    def applied(self, value):
        self.told.append((len(self.answers), value))
        for each in (self.one, self.other):
            each.applied(value)

    def _decide(self, time, state):
        raise NotImplementedError

    @property
    def commands(self):
        """Commands of both, shape (2, samples, strings)."""
        return np.array([[command.value for command in pair] for pair in self.answers]).swapaxes(
            0, 1
        )

    @property
    def statuses(self):
        """Statuses of both."""
        one, other = zip(*self.answers, strict=True)
        return [str(command) for command in one], [str(command) for command in other]

    @property
    def error(self):
        """Largest difference of the commands over the largest command."""
        one, other = self.commands
        return float(np.abs(one - other).max() / np.abs(one).max())


@cache
def model():
    return tc.Model(tc.prism(), strings=tc.LinearStrings(demo.STIFFNESS))


@cache
def plant(held, height=demo.HEIGHT):
    shape = demo.prism_of_height(model().structure, height)
    return tc.linearize(model(), tc.prestress(shape, demo.TOP_FORCE_DENSITY), input=held)


def ramp(end=demo.TARGET):
    return demo.ramp(model().structure, demo.HEIGHT, end, demo.RAMP)


def of_force_density(**options):
    """The demo's: a moving reference."""
    return tc.MPC(
        plant("force_density", demo.TARGET),
        horizon=10,
        sample_time=SAMPLE,
        max_force_density=80.0,
        reference=ramp(),
        **options,
    )


def of_rest_length():
    """Winches, soft limits on γ and tension, and a moving reference."""
    return tc.MPC(
        plant("rest_length", demo.TARGET),
        horizon=4,
        sample_time=SAMPLE,
        max_force_density=60.0,
        winches=WINCHES,
        max_tension=50.0,
        reference=ramp(),
    )


def own_weights():
    """A cross weight, and another terminal cost than the LQR's."""
    held = plant("force_density", demo.TARGET)
    Q, R = tc.plant.natural_weights(held)
    N = np.random.default_rng(0).normal(size=held.B.shape) * np.sqrt(np.diag(Q)[:, None] * R) / 60
    return {"N": N, "terminal_weight": 2 * tc.LQR(held, Q, R, N, sample_time=SAMPLE).cost}


def of_few_modes():
    """Two modes of the prism, which more inputs move than twice their states."""
    return tc.MPC(
        tc.reduce(plant("rest_length", demo.TARGET), 2),
        horizon=4,
        sample_time=SAMPLE,
        max_force_density=60.0,
        winches=WINCHES,
        max_tension=50.0,
        outputs=[tc.OutputLimit(height_row(), low=0.8, penalty=100.0)],
    )


def winding():
    """Winches that wind through samples, under an unknown load and along a moving reference."""
    return tc.MPC(
        plant("rest_length", demo.TARGET),
        horizon=4,
        sample_time=SAMPLE,
        winches=WINDING,
        load_gain=0.1,
        reference=ramp(),
    )


def with_load():
    """An unknown load is estimated, changes are limited, and so is the height."""
    return tc.MPC(
        plant("force_density"),
        horizon=6,
        sample_time=SAMPLE,
        max_force_density=80.0,
        load_gain=0.1,
        tracked=height_row(),
        max_change=4.0,
        outputs=[tc.OutputLimit(height_row(), low=0.9, penalty=100.0)],
    )


def nonlinear_of_rest_length():
    """Winches, soft limits on γ and tension and on height, linearized at each sample."""
    return tc.NMPC(
        plant("rest_length", demo.TARGET),
        horizon=3,
        sample_time=SAMPLE,
        max_force_density=60.0,
        reference=ramp(),
        winches=WINCHES,
        max_tension=50.0,
        outputs=[tc.OutputLimit(height_row(), low=0.8, penalty=100.0)],
    )


def nonlinear():
    """Linearized twice a sample, with limited changes and weights of its own."""
    return tc.NMPC(
        plant("force_density", demo.TARGET),
        horizon=3,
        sample_time=SAMPLE,
        max_force_density=80.0,
        reference=ramp(),
        max_change=10.0,
        iterations=2,
        **own_weights(),
    )


def nonlinear_with_load():
    """An unknown load is estimated, along a moving reference and with limited rows."""
    return tc.NMPC(
        plant("force_density", demo.TARGET),
        horizon=3,
        sample_time=SAMPLE,
        max_force_density=80.0,
        reference=ramp(),
        load_gain=0.1,
        tracked=height_row(),
        outputs=[tc.OutputLimit(height_row(), low=0.6, penalty=100.0)],
    )


@cache
def coupled_plant(name):
    """Plants of class 2: a D-bar and an arm in the plane, and a tower on rollers."""
    gravity = {}
    if name == "d_bar":
        structure = coupled.d_bar()
    elif name == "tower":
        structure = coupled.tower(fixed=[(i, "z") for i in range(3)])
    else:
        structure, gravity = coupled.arm(cluster=True), {"gravity": 9.81}
    model = tc.Model(structure, strings=tc.LinearStrings(500.0, damping=1.0), **gravity)
    if name == "tower":
        rest = tc.prestress(structure, coupled.tower_force_density())
    else:
        rest = tc.shape_target(model, force_density=40.0).prestress
    return tc.linearize(model, rest, input="rest_length")


def crossed():
    """Two bars crossed in the plane, linearized twice a sample: the least code of NMPC."""
    cross = tc.library.snelson_x()
    plant = tc.linearize(tc.Model(cross), tc.prestress(cross, force_density=20.0))
    return tc.NMPC(
        plant, horizon=3, sample_time=SAMPLE, max_force_density=80.0, max_change=10.0, iterations=2
    )


def rolling():
    """A regulator of a tower that rolls on a table."""
    plant = coupled_plant("tower")
    return tc.LQR(plant, *tc.energy_weights(plant), sample_time=SAMPLE, max_change=0.05)


def sliding():
    """Winches of a planar arm with a slider and a clustered string."""
    winches = tc.Winches(rate=0.5, shortest=0.1)
    return tc.MPC(coupled_plant("arm"), horizon=4, sample_time=SAMPLE, winches=winches)


def tumbling(horizon=10):
    """Winches of a ball of six bars, with soft limits on tension and γ."""
    ball = tc.library.six_bar_ball(bar_length=1.0)
    model = tc.Model(ball, strings=tc.LinearStrings(500.0, damping=1.0))
    plant = tc.linearize(model, tc.prestress(ball, force_density=40.0), input="rest_length")
    winches = tc.Winches(rate=0.5, shortest=0.05)
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # of a mechanism
        return tc.MPC(plant, horizon=horizon, sample_time=SAMPLE, winches=winches, max_tension=26.0)


@cache
def rolling_ball():
    """A ball of six bars on level ground, set down on a face, and its winches."""
    model = tc.Model(
        tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5),
        strings=tc.LinearStrings(stiffness=1000.0, damping=10.0),
        gravity=9.81,
        ground=tc.Ground(stiffness=5e3, damping=0.5, friction=0.5, slip_speed=0.05),
    )
    winches = tc.Winches(rate=0.2, shortest=0.35, longest=0.8, ramp=True)
    return model, tc.plant.set_down(model, [0, 4, 8]), winches


@cache
def rolling_gait():
    """Every second string of the ball is driven, and plans are from a table."""
    model, _, winches = rolling_ball()
    return tc.shape.RollingGait(
        model, 0.55, [1.0, 0.2, 0.0], 0.05, winches=winches, actuated=list(range(0, 24, 2)),
        tabulated=True,
    )  # fmt: skip


def shaken(pair, samples=SAMPLES):
    """Run a pair on its nonlinear plant, that starts off its shape and moves."""
    plant, r = pair.plant, pair.plant.degrees_of_freedom
    q = np.r_[0.01, np.zeros(r - 1)]
    velocities = plant.to_velocities(q, 0.1 * np.random.default_rng(0).normal(size=r))
    return tc.simulate(
        plant.model, samples * SAMPLE, plant.to_nodes(q), velocities=velocities, controller=pair,
        winches=pair.one.law.settings.winches, rest_length=plant.rest_length,
        input="rest_length", error="none",
    )  # fmt: skip


def pushed(pair, samples):
    """Ask a pair for commands at motions at random."""
    rng, plant = np.random.default_rng(3), pair.plant
    for k in range(samples):
        q, rates = np.array([[0.03], [0.3]]) * rng.normal(size=(2, plant.degrees_of_freedom))
        pair.command(k * SAMPLE, plant.to_nodes(q), plant.to_velocities(q, rates))
    assert pair.statuses[0] == pair.statuses[1]


def closed_loop(pair, pull=0.0, samples=SAMPLES, **options):
    """Run a pair on the nonlinear prism, disturbed at the start.

    Its ends are pulled apart, N at each, or not.
    """
    force = np.zeros((3, 6))
    force[2, :3], force[2, 3:] = pull, -pull
    loaded = tc.Model(model().structure, strings=model().strings, external_force=force)
    start = plant("force_density").to_nodes(np.r_[0.02, np.zeros(8)])
    return tc.simulate(
        loaded, samples * SAMPLE, start, controller=pair, step=SAMPLE, error="none", **options
    )


def pair_of(controller, folder):
    return Pair(controller, tc.generate_c(controller, folder).compile())


def check(pair, solved=True):
    """Same commands and statuses; bounds are kept."""
    statuses = pair.statuses
    assert len(pair.answers) >= SAMPLES
    assert statuses[0] == statuses[1]
    found = [
        {k for k, status in enumerate(statuses[1]) if f"measurement not {what}" in status}
        for what in ("finite", "plausible")
    ]
    assert found == [set(SPOILT), set(ABSURD)]
    spoilt = set(SPOILT + ABSURD)
    assert pair.error < 1e-10
    low, high = pair.one.bounds
    assert (pair.commands[1] >= low).all()
    assert (pair.commands[1] <= high).all()
    if solved:
        assert {statuses[0][k] for k in range(SAMPLES) if k not in spoilt} == {"ok"}
