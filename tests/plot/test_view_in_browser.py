"""Pages of views in a real browser: they load without an error, move, and show something."""

import base64
import io
import json
import os
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import tenscontrol as tc

NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--remote-debugging-pipe",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--disable-dev-shm-usage",
    "--window-size=800,600",
    "--no-first-run",
    "--disable-background-networking",
    "--host-resolver-rules=MAP * ~NOTFOUND",
]
FRAMES = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
SECONDS = 120  # after which a page has failed

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


class Browser:
    """Chromium without a window and without a network, told what to do through pipes."""

    def __init__(self, folder):
        read, self._write = os.pipe()
        self._read, write = os.pipe()

        def connect():  # Chromium reads from 3 and writes to 4
            ends = os.dup(read), os.dup(write)
            os.dup2(ends[0], 3)
            os.dup2(ends[1], 4)

        self._process = subprocess.Popen(
            [CHROMIUM, *FLAGS, f"--user-data-dir={folder}"],
            pass_fds=(3, 4),
            preexec_fn=connect,
            stderr=subprocess.DEVNULL,
        )
        os.close(read)
        os.close(write)
        self._count, self._rest, self._session, self.problems = 0, b"", None, []
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        attached = self.ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.ask(f"{domain}.enable")

    def ask(self, method, **parameters):
        """The answer to a command of the DevTools protocol; what goes wrong meanwhile is kept."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return answer["result"]
            self._keep_problem(answer)

    def _next(self):
        while b"\0" not in self._rest:
            part = os.read(self._read, 1 << 20)
            assert part, "the browser ended"
            self._rest += part
        message, self._rest = self._rest.split(b"\0", 1)
        return json.loads(message)

    def _keep_problem(self, event):
        told = event.get("params", {})
        kind = told.get("type") or told.get("entry", {}).get("level")
        if event.get("method") == "Runtime.exceptionThrown" or kind == "error":
            self.problems.append(told)

    def run(self, script):
        """The value of an expression in the page, awaited if it is a promise."""
        said = self.ask(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in said, said
        return said["result"].get("value")

    def wait(self, script):
        """Wait until an expression is true."""
        end = time.monotonic() + SECONDS
        while not self.run(script):
            assert time.monotonic() < end, (script, self.problems)
            time.sleep(0.02)

    def open(self, path):
        self.problems.clear()
        self.ask("Page.navigate", url=Path(path).as_uri())
        self.wait("document.body !== null && document.body.dataset.ready === 'yes'")

    def picture(self, path=None):
        """What is seen, shape (height, width, 3)."""
        data = base64.b64decode(self.ask("Page.captureScreenshot")["data"])
        if path is not None:
            Path(path).write_bytes(data)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)

    def mouse(self, kind, x, y, **more):
        self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def close(self):
        self.ask("Browser.close")
        self._process.wait(SECONDS)
        os.close(self._write)
        os.close(self._read)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


def points(browser, name):
    """The points of a trace, shape (3, ·), NaN where its line breaks."""
    script = f"""(() => {{
        const trace = plot.data.find((each) => each.name === {name!r});
        return [trace.x, trace.y, trace.z].map((row) => Array.from(row, (x) => x === x ? x : null));
    }})()"""
    return np.array(browser.run(script), dtype=float)


def assert_lines(browser, name, nodes, pairs):
    found = points(browser, name)
    whole = np.isfinite(found[:, ::3]).all(axis=0)
    np.testing.assert_allclose(found[: len(nodes), ::3][:, whole], nodes[:, pairs[:, 0]], atol=1e-5)
    np.testing.assert_allclose(
        found[: len(nodes), 1::3][:, whole], nodes[:, pairs[:, 1]], atol=1e-5
    )


def choose(browser, control, value):
    """Put a value into a control as a user does, and wait until it is drawn."""
    browser.run(
        f"{control}.value = {value!r}; {control}.dispatchEvent(new Event('input')); {FRAMES}"
    )


def place_on_screen(browser, node):
    """Where a node is in the window, pixels."""
    return browser.run(f"""(() => {{
        const scene = plot._fullLayout.scene._scene;
        const {{ model, view, projection }} = scene.glplot.cameraParams;
        const nodes = plot.data.find((trace) => trace.name === "nodes");
        let at = ["x", "y", "z"].map((axis, k) => nodes[axis][{node}] * scene.dataScale[k]);
        at.push(1);
        for (const matrix of [model, view, projection])
            at = [0, 1, 2, 3].map((i) => at.reduce((sum, x, j) => sum + matrix[4 * j + i] * x, 0));
        const box = plot.querySelector("canvas").getBoundingClientRect();
        const [x, y] = [at[0] / at[3], at[1] / at[3]];
        return [box.x + box.width * (x + 1) / 2, box.y + box.height * (1 - y) / 2];
    }})()""")


@pytest.fixture(scope="module")
def page_of_ball(tmp_path_factory):
    ball = tc.library.six_bar_ball()
    gamma = tc.prestress(ball, 20.0).force_density
    view = tc.plot.view(ball, force_density=gamma)
    return view.save(tmp_path_factory.mktemp("page") / "ball.html")


def test_a_structure_is_shown_and_a_node_tells_its_number(browser, page_of_ball):
    ball = tc.library.six_bar_ball()
    browser.open(page_of_ball)
    assert browser.problems == []
    assert_lines(browser, "bars", ball.nodes, ball.bars)
    assert_lines(browser, "strings", ball.nodes, ball.strings)
    seen = browser.picture()[120:, 150:680]
    grey = seen.mean(axis=2)
    assert 0.01 < np.mean(grey < 60) < 0.2  # bars, dark
    blue = (seen[..., 2] - seen[..., 0] > 40).mean()
    assert blue > 0.003  # strings under the largest tension
    assert np.mean(grey > 250) > 0.5
    x, y = place_on_screen(browser, 7)
    for shift in (2, 0):
        browser.mouse("mouseMoved", x + shift, y)
    browser.wait("plot.querySelector('.hovertext') !== null")
    assert "node 7" in browser.run("plot.querySelector('.hovertext').textContent")


def test_on_a_phone_nothing_is_cut_or_lies_over_the_drawing(browser, page_of_ball):
    metrics = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    browser.ask("Emulation.setDeviceMetricsOverride", **metrics)
    try:
        browser.open(page_of_ball)
        whole = browser.run("((page) => [page.scrollWidth, page.scrollHeight])(document.body)")
        assert whole == [390, 800]  # no scrolling
        box = "document.getElementById({!r}).getBoundingClientRect()"
        top = browser.run("plot.getBoundingClientRect().top")
        assert all(browser.run(box.format(key) + ".bottom") <= top for key in ("keys", "scale"))
        across = [place_on_screen(browser, node)[0] for node in range(12)]
        assert min(across) > 10
        assert max(across) < 380
    finally:
        browser.ask("Emulation.clearDeviceMetricsOverride")


def test_a_run_is_played_scrubbed_turned_and_coloured(browser, tmp_path):
    steel = tc.sizing.materials["steel"]
    sized = tc.sections(
        tc.library.class2_tower(stages=3), bars=steel, strings=steel, bar_radius=0.01,
        string_radius=0.001,
    )  # fmt: skip
    tower = sized.structure
    model = tc.Model(tower, strings=tc.LinearStrings(stiffness=2e3))
    plant = tc.linearize(model, tc.prestress(tower, min_force_density=20.0), input="rest_length")
    short = plant.rest_length * np.where(np.arange(len(tower.strings)) % 3, 1.0, 0.8)
    pulled = tc.Profile([0.0, 0.2], np.stack([plant.rest_length, short], axis=1))
    run = tc.simulate(model, 1.0, rest_length=pulled, output_step=0.01)
    held = tc.strength(run, sized)
    browser.open(tc.plot.view(held).save(tmp_path / "run.html"))
    assert_lines(browser, "bars", run.nodes[..., 0], tower.bars)
    browser.run("document.getElementById('play').click()")
    browser.wait("Number(scrub.value) > 2")
    eye = "plot.layout.scene.camera.eye.x"
    before = browser.run(eye)
    browser.mouse("mouseMoved", 400, 400)
    browser.mouse("mousePressed", 400, 400, button="left", buttons=1, clickCount=1)
    seen = "plot._fullLayout.scene._scene.getCamera().eye.x"
    for k in range(1, 40):  # a slow machine draws fewer frames between two moves
        browser.mouse("mouseMoved", 400 + 5 * k, 400, button="left", buttons=1)
        browser.run(FRAMES)
        if abs(browser.run(seen) - before) > 0.1:
            break
    browser.mouse("mouseReleased", 400 + 5 * k, 400, button="left", clickCount=1)
    browser.wait(f"Math.abs({eye} - {before}) > 0.1")
    turned = browser.run(eye)
    state = browser.run("scrub.value")
    browser.wait(f"scrub.value !== {state!r}")  # the motion goes on, and the eye stays
    np.testing.assert_allclose(browser.run(eye), turned, rtol=1e-9)
    browser.run("document.getElementById('play').click()")
    choose(browser, "scrub", 20)
    assert browser.run("told.textContent") == f"t = {run.time[20]:.3f} s"
    assert_lines(browser, "bars", run.nodes[..., 20], tower.bars)
    for trace, margin in (("strings", held.string_margin), ("bars", held.bar_margin)):
        line = f"plot.data.find((trace) => trace.name === {trace!r}).line"
        drawn = browser.run(f"Array.from({line}.color)")[::3]
        np.testing.assert_allclose(drawn, 1 / margin[:, 20], rtol=1e-4)
    slack = run.force_density[:, 20] == 0
    taut = np.isfinite(points(browser, "strings")[0, ::3])
    loose = np.isfinite(points(browser, "slack strings")[0, ::3])
    assert slack.any()
    np.testing.assert_array_equal(loose, slack)
    np.testing.assert_array_equal(taut, ~slack)
    tension = run.force_density[:, 20] * tower.string_length(run.nodes[..., 20])
    for name, values in (
        ("tension, N", tension),
        ("force density γ, N/m", run.force_density[:, 20]),
    ):
        choose(browser, "color", name)
        drawn = browser.run("Array.from(plot.data[0].line.color)")[::3]
        np.testing.assert_allclose(drawn, values, rtol=1e-4, atol=1e-3)
        assert browser.run("document.querySelector('#scale p').textContent") == name
        assert browser.run("plot.data[2].line.color") == "#262626"  # of bars
    choose(browser, "color", "")
    assert browser.run("document.getElementById('scale').hidden")
    assert browser.problems == []


def test_modes_of_a_planar_structure_are_flat_and_follow_the_sliders(browser, tmp_path):
    bar = tc.library.d_bar()
    plant = tc.linearize(tc.Model(bar), tc.prestress(bar, 20.0), coordinates="minimal")
    modes = tc.modes(plant)
    assert len(modes) == 4
    browser.open(modes.to_html(tmp_path / "modes.html"))
    assert browser.run("plot._fullLayout.scene.camera.projection.type") == "orthographic"
    size = np.ptp(bar.nodes, axis=1).max()
    for mode in (0, 3):
        choose(browser, "mode", mode)
        for share in (0.0, 0.05, 0.2):
            choose(browser, "amplitude", share)
            moved = points(browser, "nodes")
            np.testing.assert_allclose(moved[2], 0.0, atol=1e-12)
            far = np.linalg.norm(moved[:2] - bar.nodes, axis=0).max()
            np.testing.assert_allclose(far, share * size, rtol=1e-4, atol=1e-6)
    before = points(browser, "nodes")
    browser.run("document.getElementById('play').click()")
    browser.wait(f"Math.abs(plot.data[3].x[0] - {before[0, 0]}) > 1e-3")
    browser.run("document.getElementById('play').click()")
    assert browser.problems == []
