"""Scene files: a structure, its strings, loads, start, controller and run, written in TOML."""

from tenscontrol.scene.document import SceneError
from tenscontrol.scene.load import load_scene
from tenscontrol.scene.save import save_trajectory
from tenscontrol.scene.scene import Scene

__all__ = ["Scene", "SceneError", "load_scene", "save_trajectory"]
