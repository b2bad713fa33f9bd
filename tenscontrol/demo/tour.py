"""The steps of the demo: equilibrium and modes of a prism, LQR, a new height by MPC."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tenscontrol.actuation.rest_lengths import to_rest_length
from tenscontrol.actuation.winches import Winches
from tenscontrol.arrays import FloatArray
from tenscontrol.control.lqr import LQR
from tenscontrol.control.mpc.linear import MPC
from tenscontrol.dynamics.model import Model
from tenscontrol.dynamics.string_laws import LinearStrings
from tenscontrol.interrupt import check
from tenscontrol.plant.controllability import controllability
from tenscontrol.plant.linear_plant import LinearPlant
from tenscontrol.plant.linearize import linearize
from tenscontrol.plant.modes import Modes, modes
from tenscontrol.plant.reference import Reference
from tenscontrol.plant.riccati import energy_weights
from tenscontrol.simulation.simulate import simulate
from tenscontrol.simulation.trajectory import Trajectory
from tenscontrol.statics.prestress import Prestress, prestress, prism_force_density
from tenscontrol.structure.prism import prism, prism_radius
from tenscontrol.structure.structure import Structure

HEIGHT, TARGET = 1.0, 0.85  # m
STIFFNESS = 100.0  # N/m, every string
TOP_FORCE_DENSITY = 30.0 / np.sqrt(3.0)  # N/m, so that γ_v = 30 N/m
RAMP, DURATION = 2.0, 5.0  # s
SAMPLE, HORIZON = 0.02, 20  # s, samples
STEP = 1e-3  # s, of the integrator
WINCH_RATE = 0.5  # m/s
DISTURBANCE = 0.01  # m


@dataclass(frozen=True, eq=False)
class Morph:
    """The closed loop of the demo, its target and its height."""

    run: Trajectory
    controller: MPC
    target: Structure

    @property
    def height(self) -> FloatArray:
        """Height of the top above the bottom, m, shape (T,)."""
        return height_of(self.run.nodes)

    @property
    def height_error(self) -> float:
        """Final height less target, m."""
        return float(self.height[-1] - TARGET)


@dataclass(eq=False)
class Found:
    """What the demo has found so far."""

    rest: Prestress | None = None
    plants: dict[str, tuple[LinearPlant, Modes]] = field(default_factory=dict)
    regulator: LQR | None = None
    morph: Morph | None = None


def demo_model() -> Model:
    """Return the prism of the demo with its strings."""
    structure = prism(sides=3, radius=0.5, height=HEIGHT, bar_mass=1.0)
    return Model(structure, strings=LinearStrings(stiffness=STIFFNESS))


def show_equilibrium(structure: Structure) -> Prestress:
    """Check the closed form γ_v = √3 γ_t, and that 1 % more is refused."""
    print("1. Equilibrium")
    gamma, _ = prism_force_density(3, TOP_FORCE_DENSITY)
    rest = prestress(structure, gamma)
    print(f"   gamma_t = {gamma[0]:.4f} N/m, gamma_v = sqrt(3) gamma_t = {gamma[-1]:.4f} N/m")
    print(f"   largest unbalanced force {rest.residual:.1e} N")
    print(
        f"   {rest.self_stress_states} state of self-stress, {rest.mechanisms} mechanism; "
        f"stable: {_yes(rest.is_stable)}, super-stable: {_yes(rest.is_super_stable)}"
    )
    try:
        prestress(structure, gamma * np.repeat([1, 1, 1.01], 3))
    except ValueError as refusal:
        print(f"   gamma_v 1 % higher is refused: {str(refusal).split('. ')[0]}")
    return rest


def show_modes(model: Model, rest: Prestress) -> dict[str, tuple[LinearPlant, Modes]]:
    """Print the modes for both inputs."""
    print(f"\n2. Modes (internal coordinates: 9 of 18; k = {STIFFNESS:g} N/m)")
    by_input = {}
    for name in ("force_density", "rest_length"):
        plant = linearize(model, rest, input=name, coordinates="internal")
        by_input[name] = (plant, modes(plant))
    print("   force density held        rest length held")
    (_, free), (_, held) = by_input.values()
    for i in range(len(free.label)):
        print(
            f"   {free.frequency[i]:8.5f} Hz {free.label[i]:<12s}  "
            f"{held.frequency[i]:8.5f} Hz {held.label[i]}"
        )
    return by_input


def show_lqr(model: Model, plant: LinearPlant) -> LQR:
    """Design a regulator and try it on the nonlinear prism."""
    print("\n3. LQR, force density as the input")
    test = controllability(plant)
    weakest = int(test.margin.argmin())
    print(
        f"   all {len(plant.A)} states within reach; weakest at "
        f"{abs(test.pole[weakest]):.3f} rad/s, PBH margin {test.margin[weakest]:.3f}"
    )
    Q, R = energy_weights(plant)
    regulator = LQR(plant, Q, 0.1 * R)
    print("   closed-loop poles, 1/s:")
    upper = regulator.poles[regulator.poles.imag >= 0]
    for row in np.array_split(upper[np.argsort(upper.real)], 3):
        print("   " + "".join(f"  {pole.real:8.3f} +/- {pole.imag:6.3f}j" for pole in row))
    print(
        f"   real parts {regulator.poles.real.min():.2f} to "
        f"{regulator.poles.real.max():.2f} 1/s; Riccati residual {regulator.riccati_residual:.0e}"
    )
    start = disturbed(plant)
    run = simulate(model, 8.0, start, controller=regulator, input="force_density", step=STEP,
                   sample_time=0.01, output_step=0.01)  # fmt: skip
    check()  # part of a run does not show how it settles
    left = distance(plant, run)
    below = run.time[np.flatnonzero(left >= 1e-4)[-1] + 1]
    print(
        f"   nonlinear prism: {1e3 * left[0]:.1f} mm of disturbance below 0.1 mm after "
        f"{below:.2f} s, {1e3 * left[-1]:.4f} mm at the end"
    )
    return regulator


def show_mpc(model: Model, rest: Prestress) -> Morph:
    """Move the disturbed prism to a new height by its rest lengths."""
    print(f"\n4. MPC on the nonlinear prism, winches hold rest lengths, k = {STIFFNESS:g} N/m")
    structure = model.structure
    target = prism_of_height(structure, TARGET)
    plant = linearize(model, prestress(target, TOP_FORCE_DENSITY))
    controller = MPC(
        plant,
        horizon=HORIZON,
        sample_time=SAMPLE,
        max_force_density=80.0,
        reference=ramp(structure, HEIGHT, TARGET, RAMP),
    )
    start = disturbed(linearize(model, rest))
    winches = Winches(rate=WINCH_RATE, shortest=0.1)
    wound = to_rest_length(model, start, rest.force_density).rest_length
    run = simulate(model, DURATION, start, controller=controller, winches=winches,
                   rest_length=wound, step=STEP, progress=True)  # fmt: skip
    morph = Morph(run, controller, target)
    record = run.control
    assert record is not None  # a controller was given
    solve = 1e3 * record.computing_time
    rate = np.abs(record.winch_rate).max()
    print(
        f"   height {morph.height[0]:.4f} m -> {morph.height[-1]:.6f} m in {DURATION:g} s: ", end=""
    )
    print(f"error {1e3 * morph.height_error:+.3f} mm")
    print(f"   smallest gamma {run.force_density.min():.3f} N/m; largest winch rate {rate:.3f} m/s")
    print(f"   winches too slow in {(record.rate_limited > 0).sum()} samples")
    print(
        f"   {len(solve)} commands, {np.median(solve):.2f} ms median, "
        f"{np.percentile(solve, 99):.2f} ms 99th percentile, for a sample of {1e3 * SAMPLE:g} ms"
    )
    print("   " + run.summary().replace("\n", "\n   "))
    return morph


def prism_of_height(structure: Structure, height: float) -> Structure:
    """Return the prism with the bars of this one and another height."""
    radius = prism_radius(float(structure.bar_length[0]), height)
    return prism(sides=3, radius=radius, height=height, bar_mass=structure.bar_mass)


def ramp(structure: Structure, start: float, end: float, duration: float) -> Reference:
    """Return the reference through prisms of all heights in between, smooth at both ends."""
    time = np.linspace(0.0, duration, 41)
    share = time / duration
    heights = start + (end - start) * (10 * share**3 - 15 * share**4 + 6 * share**5)
    shapes = [prism_of_height(structure, height).nodes for height in heights]
    return Reference(time, np.stack(shapes, axis=-1))


def disturbed(plant: LinearPlant) -> FloatArray:
    """Return a shape in which the node that is farthest off is off by the demo's disturbance."""
    direction = np.random.default_rng(seed=0).normal(size=plant.degrees_of_freedom)
    size = 1e-4
    for _ in range(20):  # the displacement is nearly linear in the size: this converges at once
        off = np.linalg.norm(plant.to_nodes(size * direction) - plant.nodes, axis=0).max()
        size *= DISTURBANCE / off
    return plant.to_nodes(size * direction)


def distance(plant: LinearPlant, run: Trajectory) -> FloatArray:
    """Return how far the farthest node is from the operating shape, rigid motion apart, m."""
    r = plant.degrees_of_freedom
    moments = zip(run.nodes.T, run.velocities.T, strict=True)
    shapes = [plant.to_nodes(plant.measure(N.T, V.T)[:r]) for N, V in moments]
    return np.array([np.linalg.norm(shape - plant.nodes, axis=0).max() for shape in shapes])


def height_of(nodes: FloatArray) -> FloatArray:
    """Return the height of a three-bar prism, top less bottom, m, for nodes (3, 6, T)."""
    return np.asarray(nodes[2, :3].mean(axis=0) - nodes[2, 3:].mean(axis=0))


def _yes(value: bool) -> str:
    return "yes" if value else "no"
