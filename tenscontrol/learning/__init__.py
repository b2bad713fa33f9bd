"""Environments for learning, as gymnasium has them."""

from tenscontrol.learning.tasks import Reach, Rolling, Task, Track
from tenscontrol.learning.vector_env import vector_env

__all__ = ["Reach", "Rolling", "Task", "Track", "vector_env"]
