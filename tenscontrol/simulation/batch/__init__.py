"""Many runs of one model at once."""

from tenscontrol.simulation.batch.simulate_many import Batch, simulate_many

__all__ = ["Batch", "simulate_many"]
