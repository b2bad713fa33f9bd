"""Integrators of other packages, for comparison with ours."""

from tenscontrol.accuracy.peers.ode_solvers import CasADiCVODES, CasADiRK, SciPy
from tenscontrol.accuracy.peers.peer import Peer, Solution
from tenscontrol.accuracy.peers.rigid_bodies import MuJoCo

__all__ = [
    "CasADiCVODES",
    "CasADiRK",
    "MuJoCo",
    "Peer",
    "SciPy",
    "Solution",
]
