"""Derivatives of long runs, whose steps are found again part by part."""

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.optimize.parameters import parameters_of
from tenscontrol.optimize.run_variations import RunVariations
from tenscontrol.simulation.health import HealthLimits
from tenscontrol.simulation.integration import Integration

LENGTHS = 0.9 * tc.prism().string_length()
TIMES = np.array([0.0, 0.1, 0.25, 0.3, 0.4])


class KeptVariations(RunVariations):
    """The same with all parts kept in memory."""

    def _take(self, run):
        super()._take(run)
        self.known = [*getattr(self, "known", []), self._last[1]]

    def _part(self, i):
        if self._motors is not None:  # which are known only at the end
            self.known[i] = super()._part(i)
        return self.known[i]


def scene_of(kind):
    """A prism whose damped strings go slack."""
    prism = tc.prism()
    model = tc.Model(prism, tc.LinearStrings(100.0, damping=0.5))
    how = {"method": "dop853", "tolerance": 1e-10}
    given = {"rest_length": LENGTHS}
    plant = tc.linearize(model, tc.prestress(prism, force_density=10.0), input="rest_length")
    rates = 0.5 * np.random.default_rng(1).normal(size=plant.coordinates.count)
    velocities = plant.to_velocities(np.zeros(len(rates)), rates)
    if kind == "wound":
        wound = np.outer(LENGTHS, 1 + 0.1 * np.sin(np.arange(9)))
        given = {"rest_length": tc.Profile(np.linspace(0, 0.4, 9), wound, "cubic")}
    if kind == "shaken":
        prism = tc.Structure(prism.nodes, prism.bars, prism.strings, 1.0, fixed=[0, 1, 2])
        model, velocities = tc.Model(prism, tc.LinearStrings(100.0, damping=0.5)), None
        motion = np.broadcast_to([0.0, 0.05, 0.0, 0.03], (3, 3, 4))
        given["support_motion"] = tc.Profile(np.linspace(0, 0.4, 4), motion, "linear")
    if kind == "law":
        law = tc.LQR(plant, sample_time=0.2)
        given = {"controller": law, "rest_length": plant.equilibrium_input}
    if kind == "motors":
        law = tc.FunctionController(
            prism, lambda time, *_: LENGTHS * (1 + 0.1 * np.sin(20 * time + np.arange(9))),
            input="rest_length", sample_time=0.1,
        )  # fmt: skip
        motor = tc.Motor(0.02, torque=0.2, inertia=1e-4, backlash=0.02)
        given |= {"controller": law, "winches": tc.Winches(substeps=3, motor=motor)}
    if kind == "energy_momentum":
        how = {"method": kind, "step": 8e-3}
    limits = HealthLimits(crossings=None)
    integration = Integration(**how, error="none", output_step=0.02, limits=limits)
    return tc.Scene(model, 0.4, velocities=velocities, integration=integration, **given)


@pytest.mark.parametrize("kind", ["wound", "law", "motors", "shaken", "energy_momentum"])
def test_steps_that_are_found_again_have_the_same_derivatives_to_the_last_bit(kind):
    scene, feedback = scene_of(kind), kind == "law"
    names = ["gain" if feedback else "rest_length", "velocities", "stiffness"]
    names += ["motor.torque", "motor.inertia"] if kind == "motors" else []
    names += ["support_motion"] if kind == "shaken" else []
    parameters = parameters_of(scene, names)
    whole = RunVariations(scene, parameters, TIMES, feedback)
    costs = np.random.default_rng(2).normal(size=whole.motion().T.shape)
    results, most = [], 30 if kind in ("wound", "shaken") else 10
    for make in (RunVariations, KeptVariations):
        variations = make(scene, parameters, TIMES, feedback, expected=200, most=most)
        assert len(variations._ends) > 3
        results.append(
            (variations.motion(), variations.forward(), variations.slopes(),
             variations.backward(costs), np.array(variations.grazing))
        )  # fmt: skip
    for again, kept in zip(*results, strict=True):
        np.testing.assert_array_equal(again, kept)
    # Steps of a fixed length are those of the whole run, others are cut where parts begin.
    close = 1e-9 if kind == "energy_momentum" else 1e-6
    for again, once in zip(results[0], (whole.motion(), whole.forward()), strict=False):
        np.testing.assert_allclose(again, once, atol=close * np.abs(once).max())
    forward = np.einsum("ts,tsp->p", costs, results[0][1])
    np.testing.assert_allclose(results[0][3], forward, atol=1e-11 * np.abs(forward).max())
