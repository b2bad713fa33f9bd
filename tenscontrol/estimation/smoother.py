"""Smoother of Rauch, Tung and Striebel over a log of readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tenscontrol.arrays import FloatArray
from tenscontrol.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class SmoothedMotion:
    """Motion estimated from a whole log. Made by :meth:`KalmanFilter.smooth`.

    Attributes
    ----------
    time : ndarray, shape (K,)
        Of the samples, s, from 0.
    nodes, velocities : ndarray, shape (d, n, K)
        m and m/s. Bars have their lengths.
    node_deviation : ndarray, shape (d, n, K)
        Standard deviation of each coordinate of the nodes, m.
    filtered_node_deviation : ndarray, shape (d, n, K)
        That of the filter, which at each sample knows only the readings before. No smaller.
    bias, bias_deviation : ndarray, shape (m, K)
        Of each number of a reading, as in :class:`Estimate`.
    rest_length_error, rest_length_deviation : ndarray, shape (α, K)
        As in :class:`Estimate`, m.
    load : ndarray, shape (d, n, K), or None
        As in :class:`Estimate`, N.
    state, filtered_state : ndarray, shape (s, K)
        In the coordinates of the filter.
    covariance, filtered_covariance : ndarray, shape (K, s, s)
        Of these.
    """

    time: FloatArray
    nodes: FloatArray
    velocities: FloatArray
    node_deviation: FloatArray
    filtered_node_deviation: FloatArray
    bias: FloatArray
    bias_deviation: FloatArray
    rest_length_error: FloatArray
    rest_length_deviation: FloatArray
    load: FloatArray | None
    state: FloatArray
    filtered_state: FloatArray
    covariance: FloatArray
    filtered_covariance: FloatArray

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Pass:
    """A sample of the filter: its state after the correction, and the prediction from there.

    ``held`` is what inputs did at the sample, if that is known. ``transition`` is None where the
    filter started anew, and nothing leads to the next sample.
    """

    z: FloatArray
    P: FloatArray
    next_state: FloatArray
    next_covariance: FloatArray
    transition: FloatArray | None
    held: FloatArray | None = None


def smoothed(passes: Sequence[Pass]) -> list[tuple[FloatArray, FloatArray]]:
    """Return state and covariance at each sample, by all readings."""
    z, P = passes[-1].z, passes[-1].P
    states = [(z, P)]
    for sample in reversed(passes[:-1]):
        later_z, later_P = z, P
        z, P = sample.z, sample.P
        if sample.transition is not None:
            gain = _gain(P @ sample.transition.T, sample.next_covariance)
            z = z + gain @ (later_z - sample.next_state)
            P = P + gain @ (later_P - sample.next_covariance) @ gain.T
            P = 0.5 * (P + P.T)
        states.append((z, P))
    return states[::-1]


def _gain(cross: FloatArray, P: FloatArray) -> FloatArray:
    """Return ``cross P⁻¹``; what is known without error, of no variance, gets none."""
    size = np.sqrt(np.maximum(np.diag(P), 0.0))
    size[size == 0] = 1.0
    scaled = P / size / size[:, None]
    try:
        turned = np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError:
        return np.asarray((cross / size) @ np.linalg.pinv(scaled, 1e-14, hermitian=True) / size)
    half = np.linalg.solve(turned, (cross / size).T)
    return np.asarray(np.linalg.solve(turned.T, half).T / size)
