"""Materials and sections in a scene file: masses, rigidity and rest lengths follow."""

import numpy as np
import pytest

import tenscontrol as tc

SCENE = """
[structure]
generator = "prism"
[sections]
bars = "aluminium"
strings = "nylon"
bar_radius = 0.01
string_radius = {top = 0.001, bottom = 0.001, vertical = 0.002}
string_mass_to_nodes = true
[strings]
law = "elastic"
damping = 5.0
[prestress]
force_density = 100.0
[run]
duration = 0.01
step = 1e-3
"""


def load(folder, text):
    (folder / "sized.toml").write_text(text, encoding="utf-8")
    return tc.load_scene(folder / "sized.toml")


def test_a_scene_has_the_sections_of_a_script(tmp_path):
    scene = load(tmp_path, SCENE)
    sized = tc.sections(
        tc.prism(), bars=tc.sizing.materials["aluminium"], strings=tc.sizing.materials["nylon"],
        bar_radius=0.01, string_radius=np.repeat([0.001, 0.002], [6, 3]),
        string_mass_to_nodes=True,
    )  # fmt: skip
    np.testing.assert_array_equal(scene.structure.bar_mass, sized.structure.bar_mass)
    np.testing.assert_array_equal(scene.structure.point_mass, sized.structure.point_mass)
    np.testing.assert_array_equal(scene.model.strings.axial_rigidity, sized.axial_rigidity)
    run = scene.simulate()
    np.testing.assert_allclose(run.nodes[:, :, -1], scene.structure.nodes, atol=1e-9)


def test_strings_that_are_cut_keep_the_rigidity_of_the_whole(tmp_path):
    cut = "[subdivide]\nsegments = 2\nnode_mass = 0.01\n"
    whole = load(tmp_path, SCENE + cut)
    each = load(tmp_path, SCENE.replace("5.0", '5.0\nper = "segment"') + cut)
    for scene in (whole, each):
        rigidity = scene.model.strings.axial_rigidity
        assert rigidity[0] == pytest.approx(2.7e9 * np.pi * 1e-6)
        assert len(rigidity) == 18


OWN = """
[materials.alloy]
modulus = 60e9
density = 2700
yield_stress = 110e6
[materials."my rope"]
modulus = 2e9
density = 1100.0
yield_stress = 300e6
"""


def with_own_materials():
    return SCENE.replace('"aluminium"', '"alloy"').replace('"nylon"', '"my rope"') + OWN


def test_a_scene_has_materials_of_its_own(tmp_path):
    scene = load(tmp_path, with_own_materials())
    area = np.pi * 0.01**2
    np.testing.assert_allclose(scene.structure.bar_mass, 2700 * area * tc.prism().bar_length)
    assert scene.model.strings.axial_rigidity[0] == pytest.approx(2e9 * np.pi * 1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"alloy"', '"aloy"', "did you mean 'alloy'"),
        ("modulus = 60e9", "modulos = 60e9", r":\d+: \[materials.alloy\] has no key 'modulos'"),
        ("modulus = 60e9", "modulus = 0", r":\d+: .*\[materials.alloy\].*modulus is 0"),
        ("modulus = 60e9\n", "", r"\[materials.alloy\] lacks the key modulus"),
        ("modulus = 60e9", 'modulus = "soft"', "modulus is the text 'soft'"),
        ("[materials.alloy]", "[materials]\nwood = 1\n[materials.alloy]", "wood is no table"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_material_is_named(tmp_path, old, new, message):
    with pytest.raises(ValueError, match=message):
        load(tmp_path, with_own_materials().replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('bars = "aluminium"\n', "", "bars"),
        ('"nylon"', '"nylom"', "did you mean 'nylon'"),
        ("bar_radius = 0.01\n", "", "bar_radius or bar_area"),
        ("top = 0.001, ", "", "lacks the string group 'top'"),
        ("[strings]\nlaw = \"elastic\"", "[strings]\nlaw = \"linear\"", "stiffness"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path, old, new, message):
    with pytest.raises(ValueError, match=message):
        load(tmp_path, SCENE.replace(old, new))
