"""What tests of scenes share."""

import pytest

import tenscontrol as tc


@pytest.fixture
def load(tmp_path):
    """A function that writes a scene file and loads it."""

    def write_and_load(text):
        file = tmp_path / "scene.toml"
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        return tc.load_scene(file)

    return write_and_load
