"""The command ``tenscontrol demo``: a prism from structure to closed loop, with figures."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

from tenscontrol._version import __version__
from tenscontrol.demo import tour

__all__ = ["main"]


def main(output: Path, figures: bool = True) -> None:
    """Run the demo, print its numbers and save its figures in a folder that exists."""
    began = perf_counter()
    print(f"tenscontrol {__version__}: a tensegrity prism, 3 bars of 1 kg, 9 strings\n")
    model = tour.demo_model()
    rest = tour.show_equilibrium(model.structure)
    plants = tour.show_modes(model, rest)
    regulator = tour.show_lqr(model, plants["force_density"][0])
    morph = tour.show_mpc(model, rest)
    if figures:
        from tenscontrol.demo.figures import save_figures

        print("\n5. Figures")
        for path in save_figures(output, rest, plants, regulator, morph):
            print(f"   {path}")
    print(f"\n{perf_counter() - began:.1f} s in all")
