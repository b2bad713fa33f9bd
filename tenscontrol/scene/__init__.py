"""Scene files: a structure, its strings, loads, start, controller and run, written in TOML."""

from tenscontrol.scene.document import SceneError
from tenscontrol.scene.scene import Scene, load_scene
from tenscontrol.scene.template import scene_names, scene_template

__all__ = [
    "Scene",
    "SceneError",
    "load_scene",
    "scene_names",
    "scene_template",
]
