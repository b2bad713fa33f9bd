"""Many runs of one model at once."""

from tenscontrol.simulation.batch.compiled_loop import checked_controller
from tenscontrol.simulation.batch.simulate_many import Batch, simulate_many

__all__ = ["Batch", "checked_controller", "simulate_many"]
