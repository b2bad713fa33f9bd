"""Many runs of one model at once."""

from tenscontrol.simulation.batch.compiled_loop import checked_controller
from tenscontrol.simulation.batch.simulate_many import Batch, BatchCrossings, simulate_many

__all__ = ["Batch", "BatchCrossings", "checked_controller", "simulate_many"]
