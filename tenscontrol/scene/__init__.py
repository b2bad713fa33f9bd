"""Scene files: a structure, its strings, loads, start, controller and run, written in TOML."""

from tenscontrol.scene.document import SceneError
from tenscontrol.scene.load_scene import load_scene
from tenscontrol.scene.template import scene_names, scene_template

__all__ = [
    "SceneError",
    "load_scene",
    "scene_names",
    "scene_template",
]
