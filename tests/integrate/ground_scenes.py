"""Structures dropped on the ground, as scenes of the package and as scenes of the oracle."""

from dataclasses import dataclass, replace

import numpy as np

import tenscontrol as tc
from tenscontrol.dynamics.equation import pack_state
from tests.dynamics.scenes import side_by_side
from tests.integrate.coupled_scenes import possible_velocities
from tests.located_motion import exact_motion
from tests.oracle import HeldRestLength, Plane

GRAVITY = 9.81
GROUND = {"stiffness": 5e3, "damping": 0.3, "friction": 0.5, "slip_speed": 0.01}


@dataclass(frozen=True)
class Scene:
    """A structure over the ground, with the rest lengths of its strings and its start."""

    structure: tc.Structure
    rest_length: np.ndarray
    ground: tuple[tc.dynamics.ContactLaw, ...]
    velocities: np.ndarray
    stiffness: float = 1e3

    @property
    def model(self):
        law = tc.LinearStrings(self.stiffness)
        return tc.Model(self.structure, strings=law, gravity=GRAVITY, ground=self.ground)

    @property
    def state(self):
        return pack_state(self.structure, self.structure.nodes, self.velocities)

    def of_oracle(self):
        """Return strings, weights and planes of the oracle."""
        structure = self.structure
        d = structure.dimension
        weights = np.zeros_like(structure.nodes)
        weights[-1] = -GRAVITY * tc.structure.blocks.node_mass(structure).sum(axis=0)
        planes = tuple(
            Plane(law.stiffness, law.damping, law.friction, law.slip_speed, tuple(law.up(d)),
                  law.height, 1.5 if isinstance(law, tc.dynamics.HertzGround) else 1.0)
            for law in self.ground
        )  # fmt: skip
        return HeldRestLength(self.rest_length, self.stiffness), weights, planes

    def exact(self, times):
        """Return nodes at times, shape (d, n, T), and the times of switches, by the oracle."""
        strings, weights, planes = self.of_oracle()
        return exact_motion(self.structure, strings, times, self.velocities, None, weights, planes)

    def run(self, integrator, times):
        """Return nodes at equally spaced times from 0, shape (d, n, T), and the work."""
        span = integrator.advance(self.state, self.rest_length, times[-1], len(times) - 1)
        states = np.column_stack([self.state, span.states])
        return tc.dynamics.equation.unpack_states(self.structure, states)[0], span.work


def dropped(structure, ground, height, velocity=(0.0, 0.0, 0.0), force_density=20.0, turn=None):
    """Return the scene of a structure in prestress, turned, its lowest node at a height."""
    rest = tc.prestress(structure, force_density=force_density)
    strings = tc.LinearStrings(1e3)
    model = tc.Model(rest.structure, strings=strings)
    nodes = rest.structure.nodes.copy()
    lengths = tc.to_rest_length(model, nodes, rest.force_density).rest_length
    ground = tuple(ground)
    if turn is not None:
        nodes = turn @ nodes
    up = ground[0].up(len(nodes))
    nodes += np.outer(up, height - (up @ nodes).min())
    placed = tc.Structure(
        nodes, structure.bars, structure.strings, structure.bar_mass, structure.string_node_mass
    )
    velocities = np.repeat(np.array(velocity, float)[:, None], nodes.shape[1], axis=1)
    return Scene(placed, lengths, ground, velocities)


def rotation(axis, angle):
    """Return the matrix of a turn about an axis, rad."""
    axis = np.array(axis, float) / np.linalg.norm(axis)
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) - np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross)


def ball():
    """The six-bar ball, dropped from 0.3 m at 0.5 m/s sideways."""
    ground = tc.Ground(**GROUND)
    return dropped(tc.library.six_bar_ball(), [ground], 0.3, (0.5, 0.0, 0.0))


def prism():
    """The prism, dropped on one edge of its bottom with a spin."""
    ground = tc.Ground(**GROUND)
    scene = dropped(tc.prism(), [ground], 0.1, (0.2, 0.0, 0.0), 10.0, rotation([1, 0, 0], 0.6))
    spin = np.cross([0.0, 0.0, 2.0], scene.structure.nodes.T).T
    return replace(scene, velocities=scene.velocities + spin)


def free_tower():
    """A class-2 tower of two stages that nothing holds."""
    return tc.library.class2_tower(floating=True)


def tower():
    """The class-2 tower, set down on a slope of 20 degrees."""
    slope = np.array([np.sin(np.deg2rad(20.0)), 0.0, np.cos(np.deg2rad(20.0))])
    ground = tc.Ground(**GROUND, normal=slope)
    return dropped(free_tower(), [ground], 0.02, force_density=10.0)


SCENES = {"ball": ball, "prism": prism, "tower": tower}


def nudged(scene, size, seed):
    """Return a scene with other nodes at the start: bars keep their lengths to its square."""
    structure = scene.structure
    move = possible_velocities(structure, seed)
    nodes = structure.nodes + size * move / np.abs(move).max()
    placed = tc.Structure(
        nodes, structure.bars, structure.strings, structure.bar_mass, structure.string_node_mass
    )
    return replace(scene, structure=placed)


def resting(on_ground, copies=2):
    """Prisms side by side that stand on the ground, or hang on supports, for a while."""
    one = tc.prestress(tc.prism(), force_density=10.0).structure
    both = side_by_side(one, copies)
    nodes = both.nodes - [[0], [0], [both.nodes[2].min()]]
    low = np.flatnonzero(nodes[2] < 1e-9)
    structure = tc.Structure(
        nodes, both.bars, both.strings, both.bar_mass, fixed=[] if on_ground else low
    )
    model = tc.Model(
        structure,
        strings=tc.LinearStrings(1e3, 20.0),
        gravity=GRAVITY,
        ground=tc.Ground(**GROUND) if on_ground else None,
    )
    start = pack_state(structure, nodes, np.zeros_like(nodes))
    return model.equation("rest_length"), start, 0.9 * structure.string_length()
