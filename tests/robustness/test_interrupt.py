"""Ctrl-C in a script: it ends at once, with the report of what is done."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="a process group gets no Ctrl-C there")

ROOT = Path(__file__).parents[2]

# More of it than a pipe holds is on its way to the workers when they are ended.
SCRIPT = """
import os, signal, time
import tenscontrol as tc

def say(text):
    # In one piece, so that what two workers say at the same time stays in lines:
    # print writes text and end of line apart where output is not buffered.
    os.write(1, f"{text}\\n".encode())

class Case:
    def __init__(self):
        self.ballast = bytes(300_000)

    def __call__(self, parameters, rng):
        if parameters["x"] == 1.0:
            say("at work")
            time.sleep(600)
        return tc.robustness.Outcome(success=True)

if __name__ == "__main__":
    # A shell lets what it starts in the background ignore Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    report = tc.sweep(Case(), {"x": tc.OneOf([0.0, 1.0])}, 60, seed=0, processes=2)
    say(f"{len(report)} runs reported")
"""


@contextmanager
def started(tmp_path):
    """The script, when a worker has said that it is at work."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, "utf-8")
    with subprocess.Popen(
        [sys.executable, script],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    ) as process:  # fmt: skip
        try:
            assert process.stdout.readline() == "at work\n"
            yield process
        finally:
            # Also workers that have outlived their parent: all are of one group.
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def test_ctrl_c_ends_the_script(tmp_path):
    """Runs of ten minutes do not hold it up."""
    with started(tmp_path) as process:
        os.killpg(process.pid, signal.SIGINT)  # as the terminal does
        # This waits for the workers too, which hold the pipes.
        out, error = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "runs reported" in out
    assert "RuntimeWarning: the sweep was interrupted with" in error
    assert "Traceback" not in error


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_end_with_the_script_however_it_ends(tmp_path, number):
    with started(tmp_path) as process:
        process.send_signal(number)
        process.communicate(timeout=60)  # of the workers too
