"""Sphinx configuration."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

from example_numbers import check_numbers, keep_names  # beside this file

project = "tenscontrol"
author = "The tenscontrol developers"
copyright = "2026, The tenscontrol developers"
release = version = installed_version("tenscontrol")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "folder",
    "mathml",
    "myst_nb",
    "scene_keys",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "gallery/*.ipynb"]
html_math_renderer = "mathml"
nb_execution_mode = "force"  # notebooks keep no outputs: the build runs them
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["formulas.css"]
html_title = f"tenscontrol {release}"

autodoc_typehints = "none"  # shapes and units are in the docstrings
autodoc_member_order = "bysource"
autosummary_generate = True
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False


def place_in_gallery(path: str) -> int:
    """Return where the gallery's index has an example."""
    return _GALLERY_INDEX.index(Path(path).name)


_GALLERY_INDEX = (Path(__file__).parent.parent / "examples" / "index.rst").read_text("utf-8")

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/.*\.py",
    "ignore_pattern": r"(_study|learn_to_roll)\.py",  # what examples import; needs torch
    "copyfile_regex": r"index\.rst",  # sections, and examples in the order of their difficulty
    "minigallery_sort_order": place_in_gallery,
    "backreferences_dir": "gen_modules",  # galleries of a section need one
    "abort_on_example_error": True,
    "image_scrapers": ("matplotlib", keep_names),
    "reset_modules": ("matplotlib", "seaborn", check_numbers),
    "reset_modules_order": "both",
    "capture_repr": ("_repr_html_",),  # not the text of what a plot function returns
    "show_memory": False,
    "min_reported_time": 1,
    "remove_config_comments": True,
    "download_all_examples": False,
    "matplotlib_animations": False,
}
# Gallery settings hold functions, which are not cached. Names of attributes are taken for
# references, and several classes have one of the same name. Objects that Jupyter draws by plotly
# are text on a page.
suppress_warnings = ["config.cache", "ref.python", "mystnb.unknown_mime_type"]
