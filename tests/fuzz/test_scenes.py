"""A small part of the campaign over spoilt scene files; see ``tests/fuzz/scenes.py``."""

import pytest

from tests.fuzz import scenes


@pytest.mark.parametrize("first", range(0, 80, 20))
def test_spoilt_scenes_are_loaded_or_refused_in_our_words(tmp_path, first):
    file = tmp_path / "scene.toml"
    for number in range(first, first + 20):
        file.write_bytes(scenes.spoilt(number, seed="suite"))
        kind, message, _ = scenes.outcome(file)
        assert kind in ("loaded", "refused"), (number, message)


def test_the_same_number_spoils_the_same_way():
    assert scenes.spoilt(7) == scenes.spoilt(7)
    assert len({scenes.spoilt(number) for number in range(50)}) >= 48  # two may hit the same place


def test_an_error_that_is_not_ours_is_found():
    with pytest.raises(IndexError) as raised:
        [][0]
    assert scenes._judged(raised.value, "")[0] == "uncaught"
    with pytest.raises(ValueError) as raised:
        float("x")
    assert scenes._judged(raised.value, "")[0] == "from within"
