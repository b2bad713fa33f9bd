"""Controllers as C code: generated, compiled, and run in the loop."""

from tenscontrol.deploy.compiled_controller import CompiledController
from tenscontrol.deploy.generate import GeneratedController, generate_c

__all__ = [
    "CompiledController",
    "GeneratedController",
    "generate_c",
]
