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
from PIL import Image

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
FLAGS = (
    "--headless --no-sandbox --remote-debugging-pipe --use-angle=swiftshader --hide-scrollbars "
    "--enable-unsafe-swiftshader --disable-dev-shm-usage --window-size=900,700 --no-first-run "
    "--disable-background-networking --host-resolver-rules=MAP\\ *\\ ~NOTFOUND"
)
SECONDS = 60  # after which a page has failed


class Browser:
    """Chromium without a window and without a network, told what to do through pipes."""

    def __init__(self, folder):
        read, self._write = os.pipe()
        self._read, write = os.pipe()
        command = f"exec {CHROMIUM} {FLAGS} --user-data-dir={folder} 3<&{read} 4>&{write}"
        self._process = subprocess.Popen(
            ["/bin/sh", "-c", command], pass_fds=(read, write), stderr=subprocess.DEVNULL
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
        if event.get("method") == "Runtime.exceptionThrown" or kind in ("error", "warning"):
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
