"""Scene files: a structure, its strings, loads, start, controller and run, written in TOML."""

from tenscontrol.scene.document import SceneError
from tenscontrol.scene.scene import Scene, load_scene

__all__ = ["Scene", "SceneError", "load_scene"]
