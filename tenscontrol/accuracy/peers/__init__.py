"""Integrators of other packages, as peers to measure ours against."""

from tenscontrol.accuracy.peers.casadi_methods import CasADiCVODES, CasADiRK
from tenscontrol.accuracy.peers.rigid_bodies import MuJoCo
from tenscontrol.accuracy.peers.scipy_methods import SciPy

__all__ = ["CasADiCVODES", "CasADiRK", "MuJoCo", "SciPy"]
