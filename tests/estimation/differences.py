"""Central differences along directions that have all entries of a state."""

import numpy as np


def differences(function, z, count=6, step=3e-6):
    """Return directions, shape (n, count), and how much the function changes along each."""
    along = np.random.default_rng(0).choice([-1.0, 1.0], size=(len(z), count))
    changes = [function(z + step * d) - function(z - step * d) for d in along.T]
    return along, np.column_stack(changes) / (2 * step)
