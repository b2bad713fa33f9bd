"""Scene files: a structure, its strings, loads, start, controller and run, written in TOML."""

from tenscontrol.scene.document import SceneError
from tenscontrol.scene.load_scene import load_scene
from tenscontrol.scene.scene import Scene, save_trajectory

__all__ = ["Scene", "SceneError", "load_scene", "save_trajectory"]
