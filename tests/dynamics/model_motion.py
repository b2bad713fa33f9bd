"""The package's equation of motion, integrated as the independent models are."""

import numpy as np

from tenscontrol.dynamics.equation import pack_state, unpack_states
from tenscontrol.dynamics.evaluator import Evaluator
from tests.oracle import Motion


class ModelMotion(Motion):
    """A model with held rest lengths or force densities; the state is the package's."""

    def __init__(self, model, input, held, form="flat"):
        self.structure, self.held = model.structure, held
        equation = model.equation(input, form=form)
        self._slope, self._gap = Evaluator(equation.slope), Evaluator(equation.gap)
        self._switches = equation.switches

    def state(self, nodes, velocities):
        return pack_state(self.structure, nodes, velocities)

    def nodes(self, state):
        """Return node positions and velocities, shape (d, n) each."""
        return tuple(part[:, :, 0] for part in unpack_states(self.structure, state[:, None]))

    def slope(self, state, pulls):
        taut = np.asarray(pulls, float) if self._switches else np.zeros(0)
        return self._slope(state, self.held, taut)[0].copy()

    def border(self, states):
        if not self._switches:
            return np.ones((*np.shape(states)[:-1], len(self.structure.strings)))
        each = [self._gap(state, self.held)[0].copy() for state in np.atleast_2d(states)]
        return np.array(each) if np.ndim(states) == 2 else each[0]
