"""MJCF comes back as it went, and from others as MuJoCo itself places it."""

from xml.etree import ElementTree

import numpy as np
import pytest

import tenscontrol as tc
from tenscontrol.exchange import mjcf_document
from tests.exchange.structures import library, others

STRUCTURES = library() | others()


def assert_same(found, expected):
    for name in ("bars", "strings", "fixed", "segments"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    for name in ("dimension", "paths", "string_groups"):
        assert getattr(found, name) == getattr(expected, name)
    assert sorted(found.rollers) == sorted(expected.rollers)
    for name in ("nodes", "bar_mass", "point_mass"):
        pair = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(*pair, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", STRUCTURES)
@pytest.mark.parametrize("elastic", [False, True])
def test_every_structure_goes_to_mjcf_and_back(name, elastic):
    structure, random = STRUCTURES[name], np.random.default_rng(0)
    count = len(structure.strings)
    stiffness, damping = random.uniform(1e2, 1e3, count), random.uniform(0, 1, count)
    law = (tc.ElasticStrings if elastic else tc.LinearStrings)(stiffness, damping)
    rest = structure.string_length() * random.uniform(0.8, 1.1, count)
    model = tc.Model(structure, strings=law, gravity=9.81)
    actuators = "rest_length" if elastic else "none"
    found = tc.exchange.from_mujoco(
        tc.exchange.to_mujoco(model, rest_length=rest, actuators=actuators)
    )
    assert_same(found.structure, structure)
    np.testing.assert_allclose(found.rest_length, rest, rtol=1e-12)
    assert type(found.model.strings) is type(law)
    back = found.model.strings
    np.testing.assert_allclose(back.axial_rigidity if elastic else back.stiffness, stiffness)
    np.testing.assert_allclose(back.damping, damping, rtol=1e-12)
    np.testing.assert_allclose(found.model.gravity, model.gravity, atol=1e-15)
    assert found.notes == ()


def test_a_spring_of_an_actuator_is_a_string():
    ball = STRUCTURES["six_bar_ball"]
    model = tc.Model(ball, strings=tc.LinearStrings(300.0, 0.5))
    text = tc.exchange.to_mujoco(model, rest_length=1.0, actuators="rest_length")
    found = tc.exchange.from_mujoco(text)
    np.testing.assert_array_equal(found.model.strings.stiffness, np.full(24, 300.0))
    np.testing.assert_array_equal(found.rest_length, np.ones(24))


@pytest.mark.parametrize("actuators", ["none", "tension", "force_density"])
def test_strings_without_force_come_back(actuators):
    model = tc.Model(tc.prism())
    gamma = np.r_[np.zeros(3), np.ones(6)]
    text = tc.exchange.to_mujoco(model, force_density=gamma, actuators=actuators)
    found = tc.exchange.from_mujoco(text)
    assert_same(found.structure, model.structure)
    assert found.model.strings is None
    assert found.rest_length is None
    assert found.notes


# Three bars as others write them: defaults, classes, degrees, nested bodies, masses by density.
FOREIGN = """
<mujoco>
  <compiler angle="degree"/>
  <option gravity="0 0 -1.62"/>
  <default>
    <geom density="500"/>
    <tendon stiffness="250" damping="0.4" springlength="0 0.6"/>
    <default class="strut"><geom type="capsule" size="0.02"/></default>
    <default class="soft"><tendon stiffness="80"/></default>
  </default>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="1 1 1"/>
    <site name="anchor" pos="0 0 2"/>
    <body name="first" pos="0 0 1" euler="0 90 30" childclass="strut">
      <freejoint/>
      <geom name="strut" fromto="-0.5 0 0 0.5 0 0"/>
      <geom name="load" class="main" type="sphere" size="0.03" pos="0.5 0 0" mass="0.25"/>
      <site name="a" pos="-0.5 0 0"/>
      <body name="second" pos="0.5 0 0" quat="0.5 0.5 0.5 0.5">
        <joint type="ball"/>
        <geom type="cylinder" size="0.02 0.4" pos="0 0 0.4" mass="0.8"/>
        <site name="b" pos="0 0 0.8"/>
      </body>
    </body>
    <body name="third" pos="0.3 0.2 0.1" axisangle="0 1 0 45">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
      <joint type="slide" axis="0 0 1"/><joint type="ball"/>
      <inertial pos="0 0 0.25" mass="2" diaginertia="0.05 0.05 0.001"/>
      <geom class="strut" fromto="0 0 0 0 0 0.5"/>
      <site name="c"/><site name="d" pos="0 0 0.5"/>
    </body>
    <body name="weight" pos="1 1 1"><freejoint/><geom size="0.1" mass="0.5"/><site name="w"/></body>
  </worldbody>
  <tendon>
    <spatial name="one"><site site="a"/><site site="c"/></spatial>
    <spatial name="two" class="soft"><site site="b"/><site site="w"/><site site="d"/></spatial>
    <spatial name="three" springlength="-1"><site site="anchor"/><site site="a"/></spatial>
    <spatial name="four" stiffness="0" springlength="0 0.3">
      <site site="w"/><site site="c"/>
    </spatial>
    <spatial name="gauge" stiffness="0" springlength="1.7">
      <site site="a"/><site site="d"/>
    </spatial>
  </tendon>
  <actuator><position tendon="four" kp="40" kv="2"/></actuator>
</mujoco>
"""


def test_what_others_write_is_placed_as_mujoco_places_it():
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo comes with the extra test")
    found = tc.exchange.from_mujoco(FOREIGN)
    model = mujoco.MjModel.from_xml_string(FOREIGN)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    structure = found.structure
    sites = {model.site(i).name: data.site_xpos[i] for i in range(model.nsite)}
    ends = {0: "ac", 1: "bd", 2: ("anchor", "a"), 3: "wc"}
    for string, names in ends.items():
        for node, name in zip(structure.strings[string], names, strict=True):
            np.testing.assert_allclose(structure.nodes[:, node], sites[name], atol=1e-12)
    np.testing.assert_allclose(structure.string_length(), data.ten_length[:4], atol=1e-12)
    np.testing.assert_allclose(found.rest_length, [0.6, 0.6, data.ten_length[2], 0.3])
    np.testing.assert_array_equal(found.model.strings.stiffness, [250, 80, 250, 40])
    np.testing.assert_array_equal(found.model.strings.damping, [0.4, 0.4, 0.4, 2.0])
    assert structure.paths[1] == (
        structure.paths[1][0],
        structure.paths[1][1],
        structure.paths[1][2],
    )
    assert structure.string_groups == ("string", "soft", "string", "string")
    total = structure.bar_mass.sum() + structure.point_mass.sum()
    assert total == pytest.approx(model.body_mass.sum(), rel=1e-12)
    assert len(structure.fixed) == 1
    assert structure.structure_class == 2
    np.testing.assert_allclose(found.model.gravity, [0, 0, -1.62])
    assert len(found.notes) == 4
    assert any("thin bar" in note for note in found.notes)
    assert "tendon 'gauge' pulls by nothing and is left out" in found.notes
    assert any("floor" in note for note in found.notes)


def test_files_are_read_by_their_path(tmp_path):
    file = tmp_path / "three.xml"
    file.write_text(FOREIGN)
    assert_same(tc.exchange.from_mujoco(file).structure, tc.exchange.from_mujoco(FOREIGN).structure)
    with pytest.raises(FileNotFoundError):
        tc.exchange.from_mujoco(tmp_path / "none.xml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("</mujoco>", "", "source is not XML"),
        ("<mujoco>", "<mujoco><deformable/>", "<deformable>, which is not understood"),
        ("<compiler ", "<compiler coordinate='global' ", "which MuJoCo dropped in 2.3.4"),
        ("<light", "<composite/><light", "<composite>, which is not understood"),
        ('class="soft"><site', 'class="firm"><site', "class 'firm', which it does not define"),
        ('<site site="d"/>', '<site site="x"/>', "names the site 'x'"),
        ('<site site="w"/><site site="d"/>', '<geom geom="floor"/>', "over a <geom>"),
        ('<site name="c"/>', '<site name="c" pos="0 0 0.1"/>', "'c' is 0.1 m from the nearer end"),
        ('<joint type="ball"/>\n        <geom', '<joint/>\n        <geom', "moves in space"),
        ('<geom type="cylinder"', '<geom type="capsule" fromto="0 0 0 1 0 0" size="1"/>'
         '<geom type="cylinder"', "has two bars"),
        ('<inertial pos="0 0 0.25"', '<inertial pos="0 0 0.2"', "centre of mass off the middle"),
        ('<joint type="slide" axis="1 0 0"/>', "", "not along all axes"),
        ('<joint type="slide" axis="1 0 0"/>', '<joint type="slide" axis="0 1 0"/>', "twice along"),
        ("<actuator>", '<equality><connect site1="a"/></equality><actuator>', "names the site ''"),
        ('stiffness="80"', 'stiffness="80 1"', "stiffness that changes with its length"),
        ("<actuator>", '<equality><joint joint1="x"/></equality><actuator>', "constraint <joint>"),
        ("<tendon>\n", '<tendon><fixed name="f"/>\n', "'f' is <fixed>, not spatial"),
        ('pos="0 0 2"', 'pos="0 0"', "pos='0 0', expected 3 numbers"),
        (FOREIGN, "<mujoco><worldbody><site/><site name='a'/></worldbody></mujoco>",
         "neither capsules nor tendons"),
    ],
)  # fmt: skip
def test_what_is_not_understood_is_named(old, new, message):
    assert old in FOREIGN
    with pytest.raises(ValueError, match=message):
        tc.exchange.from_mujoco(FOREIGN.replace(old, new))


def test_a_node_that_slides_in_a_plane_among_supports_beside_it_is_on_a_roller():
    text = """<mujoco><worldbody>
    <site name="a" pos="0 1 0"/><site name="b" pos="2 -1 0"/><site name="c" pos="1 0 3"/>
    <body pos="1 0 1"><joint type="slide"/><joint type="slide" axis="1 0 0"/>
    <geom size="0.1" mass="1"/><site name="p"/></body></worldbody><tendon>
    <spatial stiffness="10"><site site="a"/><site site="p"/></spatial>
    <spatial stiffness="10"><site site="b"/><site site="p"/></spatial>
    <spatial stiffness="10"><site site="c"/><site site="p"/></spatial></tendon></mujoco>"""
    found = tc.exchange.from_mujoco(text).structure
    ((node, axis),) = found.rollers
    np.testing.assert_array_equal(found.nodes[:, node], [1, 0, 1])
    assert axis == "y"
    level = text.replace('"0 1 0"', '"0 0 0"').replace('"2 -1 0"', '"2 0 0"')
    assert tc.exchange.from_mujoco(level).structure.dimension == 2


WRONG = (None, "", "x", "nan", "0", "-1 0", "1 2 3")


def spoilt():
    """The text with each of its attributes in turn left out or made another."""
    count = sum(len(element.attrib) for element in ElementTree.fromstring(FOREIGN).iter())
    for i in range(2 * count):
        root, value = ElementTree.fromstring(FOREIGN), WRONG[i % len(WRONG)]
        element, key = [(each, key) for each in root.iter() for key in each.attrib][i % count]
        if value is None:
            del element.attrib[key]
        else:
            element.set(key, value)
        yield ElementTree.tostring(root, encoding="unicode")


def test_a_spoilt_attribute_is_refused_in_words_or_does_not_matter():
    said = []
    for text in spoilt():
        try:
            tc.exchange.from_mujoco(text)
        except ValueError as error:
            said.append(str(error))
    assert len(said) > 80
    assert not [words for words in said if "convert" in words or "index" in words]


def test_a_site_beside_the_end_of_its_bar_is_put_there_if_asked():
    text = FOREIGN.replace('<site name="c"/>', '<site name="c" pos="0 0 0.01"/>')
    exact, moved = tc.exchange.from_mujoco(FOREIGN), tc.exchange.from_mujoco(text, tolerance=0.05)
    assert_same(moved.structure, exact.structure)


BOMBS = {
    "bodies": ("<worldbody>" + "<body>" * 5_000, "500 levels of elements .*line 1, <body>"),
    "defaults": ("<default>" * 5_000, "500 levels of elements .* line 1, <default>"),
    "elements": ("<worldbody>" + "<site/>" * 5_000, "5,000 elements, the most that are read"),
    "attributes": (
        "<site " + " ".join(f"a{i}='1'" for i in range(101)) + "/>",
        "100 attributes in",
    ),
}


@pytest.mark.parametrize("name", BOMBS)
def test_texts_that_ask_for_too_much_are_refused(name, monkeypatch):
    assert mjcf_document._MOST_ELEMENTS == 500_000
    monkeypatch.setattr(mjcf_document, "_MOST_ELEMENTS", 5_000)
    text, message = BOMBS[name]
    with pytest.raises(ValueError, match=f"source has more than {message}"):
        tc.exchange.from_mujoco("<mujoco>" + text)


def test_a_long_attribute_is_no_number():
    text = FOREIGN.replace('gravity="0 0 -1.62"', f'gravity="{"0 " * 1_000_000}"')
    with pytest.raises(ValueError, match=r"gravity='0 0 0 .*expected numbers") as raised:
        tc.exchange.from_mujoco(text)
    assert len(str(raised.value)) < 200


def test_declarations_of_entities_and_attributes_are_refused():
    laughs = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 12))
    etc = '<!ENTITY l11 SYSTEM "file:///etc/passwd">'
    for declared in ('<!ENTITY l0 "lol">' + laughs, etc, "<!ATTLIST geom mass CDATA '1'>"):
        text = f"<!DOCTYPE mujoco [{declared}]>" + FOREIGN.strip().replace("three", "&l11;")
        with pytest.raises(ValueError, match=r"declares entities or attributes in <!DOCTYPE"):
            tc.exchange.from_mujoco(text)
    assert_same(
        tc.exchange.from_mujoco("<!DOCTYPE mujoco>" + FOREIGN).structure,
        tc.exchange.from_mujoco(FOREIGN).structure,
    )


def tower(count):
    """Bars that float apart, each tied to the next and to the world."""
    bodies = "".join(
        f'<site name="w{i}" pos="{i} 1 0"/><body pos="{i} 0 0"><freejoint/><geom type="capsule" '
        f'fromto="0 0 0 0 0 1" size="1"/><site name="a{i}"/><site name="b{i}" pos="0 0 1"/></body>'
        for i in range(count)
    )
    tendons = "".join(
        f'<spatial><site site="a{i}"/><site site="b{(i + 1) % count}"/></spatial>'
        f'<spatial><site site="w{i}"/><site site="a{i}"/></spatial>'
        for i in range(count)
    )
    return f"<mujoco><worldbody>{bodies}</worldbody><tendon>{tendons}</tendon></mujoco>"


def test_the_work_grows_as_the_file(monkeypatch):
    """Twice as many bars take twice as many comparisons of places, not four times."""
    work, norm = [], np.linalg.norm

    def counted(*arguments, **settings):
        work[-1] += 1
        return norm(*arguments, **settings)

    for count in (20, 40):
        text = tower(count)
        work.append(0)
        with monkeypatch.context() as patched:
            patched.setattr(np.linalg, "norm", counted)
            found = tc.exchange.from_mujoco(text)
        assert found.structure.nodes.shape == (3, 3 * count)
    assert work[1] < 2.2 * work[0]
