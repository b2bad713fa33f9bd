"""Random scenes and their references: the oracle in C is the one in NumPy, and files are kept."""

import numpy as np
import pytest

from tests import references
from tests.located_motion import OracleError, c_compiler
from tests.oracle import HeldForceDensity, HeldRestLength, NodeMotion
from tests.random_scenes import plane_of, random_scene, stiffness_of
from tests.references import TIMES, error_between, fingerprint, reference

pytestmark = [
    pytest.mark.skipif(c_compiler() is None, reason="there is no C compiler"),
    pytest.mark.filterwarnings(r"ignore:strings\[\d+\] joins nodes:UserWarning"),
]


def in_numpy(scene, times):
    """Nodes by the oracle in NumPy."""
    held = HeldForceDensity(scene.value)
    if scene.input == "rest_length":
        stiffness = stiffness_of(scene.strings, scene.value)
        held = HeldRestLength(scene.value, stiffness, scene.strings.damping)
    ground = tuple(plane_of(each, scene.structure) for each in scene.ground)
    motion = NodeMotion(scene.structure, held, scene.load, ground)
    return motion.integrate(scene.structure.nodes, scene.velocities, times, 1e-12)


# On ground; planar, with rollers; damped, with a load; point masses; force densities.
@pytest.mark.parametrize("seed", [35, 94, 102, 109, 152])
def test_the_oracle_in_c_is_the_one_in_numpy(seed):
    scene = random_scene(seed)
    times = np.linspace(0, scene.duration, 5)
    found, work = scene.located(times)
    expected, switches = in_numpy(scene, times)
    assert error_between(scene, found, expected).max() < 1e-9
    assert work.switches == len(switches)


def test_a_motion_that_takes_too_many_evaluations_is_refused():
    scene = random_scene(35)
    with pytest.raises(OracleError, match="too many evaluations"):
        scene.located(np.array([0.0, scene.duration]), most_evaluations=100)


def test_the_same_seed_gives_the_same_scene():
    assert fingerprint(random_scene(3)) == fingerprint(random_scene(3))
    assert fingerprint(random_scene(3)) != fingerprint(random_scene(9))


def test_a_reference_is_read_again_and_belongs_to_its_scene(tmp_path, monkeypatch):
    first = reference(random_scene(35), tmp_path)
    assert first.status == "ok"
    assert first.is_certain_to_the_end
    assert first.certain_to.max() < 1e-9
    assert first.judged.tolist() == list(range(1, TIMES + 1))
    monkeypatch.setattr(references, "_computed", None)  # nothing is computed again
    again = reference(random_scene(35), tmp_path)
    assert np.array_equal(again.nodes, first.nodes)
    assert (again.status, again.switches) == (first.status, first.switches)
    monkeypatch.undo()
    (tmp_path / "scene_000035.npz").rename(tmp_path / "scene_000048.npz")
    other = reference(random_scene(48), tmp_path)
    assert other.nodes.shape == (2, 2, TIMES + 1)


def test_a_run_that_takes_too_long_ends():
    def endless():
        while True:
            sum(range(1000))

    with pytest.raises(references.TimeLimitError), references.time_limit(0.05):
        endless()
