"""Numbers of the examples, checked by ``tests/examples.py`` once the gallery has run one."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent.parent))

from tests.examples import NUMBERS

_ran = {}  # what the gallery keeps of an example, by its file


def keep_names(block, variables, settings):
    """Keep the names that an example defines: a scraper of images, called after each block."""
    _ran[Path(variables["src_file"]).name] = variables
    return ""


def check_numbers(settings, example, when):
    """Check the numbers of an example that has run, and that it draws its thumbnail."""
    if when == "after":
        name = Path(example).name
        variables = _ran.pop(name)
        thumbnail = variables["file_conf"].get("thumbnail_number", 1)
        assert len(variables["image_path_iterator"]) >= thumbnail, name
        NUMBERS[name](variables["example_globals"])
