"""A load that the model does not know, as further states of a filter."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from tenscontrol.estimation.design import FilterDesign
from tenscontrol.estimation.outputs import output_function
from tenscontrol.plant import Sampled, acceleration_response
from tenscontrol.validation import FloatArray

# Standard deviation of the load at the start, as a part of the pull of a string.
_START = 0.3


def with_load(design: FilterDesign, pull: float, walk: float) -> FilterDesign:
    """Return the design with the acceleration a that a load gives as states after z.

    ``z⁺ = Φ z + … + Ψ a``, with Ψ what unit accelerations do in a sample, and
    ``a⁺ = a + w'``: a random walk.

    Parameters
    ----------
    design : FilterDesign
        Without a load.
    pull : float
        Acceleration that a string gives.
    walk : float
        Standard deviation of w', as a part of it.
    """
    by_load = acceleration_response(design.plant, design.sample_time)
    in_a_piece = acceleration_response(design.plant, design.sample_time / design.substeps)
    size, r = by_load.shape
    eye, zero = np.eye(r), np.zeros((size, r))
    moved, none = design.sampled, np.zeros((r, design.plant.B.shape[1]))

    def joined(of_state: FloatArray, share: float) -> FloatArray:
        return np.block([[of_state, zero], [zero.T, (share * pull) ** 2 * eye]])

    motion = design.motion
    return replace(
        design,
        load=True,
        sampled=Sampled(
            sample_time=moved.sample_time,
            transition=np.block([[moved.transition, by_load], [zero.T, eye]]),
            by_previous=np.vstack([moved.by_previous, none]),
            by_input=np.vstack([moved.by_input, none]),
            drift=np.r_[moved.drift, np.zeros(r)],
            ramp=moved.ramp,
        ),
        process_covariance=joined(design.process_covariance, walk),
        start_covariance=joined(design.start_covariance, _START),
        start=np.r_[design.start, np.zeros(r)],
        outputs=output_function(design.plant, design.sensors, more=r),
        motion=None if motion is None else _under_load(motion, in_a_piece),
    )


def _under_load(motion: ca.Function, by_load: FloatArray) -> ca.Function:
    """Return ``(z, u) -> (z⁺, ∂z⁺/∂z, ∂z⁺/∂u)`` under a load, to first order in the load."""
    size, r = by_load.shape
    z, u = ca.MX.sym("z", size + r), ca.MX.sym("u", motion.size1_in(1))
    end, of_state, of_input = motion(z[:size], u)
    end = ca.vertcat(end + ca.DM(by_load) @ z[size:], z[size:])
    rows = ca.blockcat([[of_state, ca.DM(by_load)], [ca.DM(r, size), ca.DM.eye(r)]])
    below = ca.vertcat(of_input, ca.DM(r, motion.size1_in(1)))
    return ca.Function("loaded", [z, u], [ca.densify(each) for each in (end, rows, below)])
