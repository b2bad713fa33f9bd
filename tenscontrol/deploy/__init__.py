"""Controllers as C code: generated, compiled, and run in the loop."""

from tenscontrol.deploy.compiled_controller import CompiledController, CompiledGait
from tenscontrol.deploy.generate import GeneratedController, generate_c
from tenscontrol.deploy.memory_use import MemoryUse

__all__ = [
    "CompiledController",
    "CompiledGait",
    "GeneratedController",
    "MemoryUse",
    "generate_c",
]
