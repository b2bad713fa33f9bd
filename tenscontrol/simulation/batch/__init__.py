"""Many runs of one model at once."""

from tenscontrol.simulation.batch.simulate_many import Batch, BatchCrossings, simulate_many

__all__ = [
    "Batch",
    "BatchCrossings",
    "simulate_many",
]
