"""The command ``tenscontrol demo``: a prism from structure to closed loop, with figures."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from time import perf_counter

from tenscontrol._version import __version__
from tenscontrol.demo import tour
from tenscontrol.interrupt import interruptible


def main(output: Path, figures: bool = True) -> None:
    """Run the demo, print its numbers and save its figures in a folder that exists.

    If it is interrupted, the figures of what is done are saved.
    """
    began = perf_counter()
    print(f"tenscontrol {__version__}: a tensegrity prism, 3 bars of 1 kg, 9 strings\n")
    results = tour.Found()
    with interruptible(), suppress(KeyboardInterrupt):
        model = tour.demo_model()
        results.rest = tour.show_equilibrium(model.structure)
        results.plants = tour.show_modes(model, results.rest)
        results.regulator = tour.show_lqr(model, results.plants["force_density"][0])
        results.morph = tour.show_mpc(model, results.rest)
    if figures:
        from tenscontrol.demo.figures import save_figures

        print("\n5. Figures")
        for path in save_figures(output, results):
            print(f"   {path}")
    print(f"\n{perf_counter() - began:.1f} s in all")
