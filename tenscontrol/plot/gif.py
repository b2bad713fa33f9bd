"""Pictures of a figure, one after the other, in a GIF."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

# Drawings of lines need few. One palette for all pictures makes the file a third
# of what matplotlib's PillowWriter makes it, and keeps colours from flickering.
_COLORS = 64

# Pillow takes the mean of similar colours, and paper turns grey.
_NEARLY_WHITE = 247


def write_gif(path: Path, canvas: Any, pictures: Iterable[None], count: int, rate: float) -> None:
    """Write what the canvas shows after each step of ``pictures``, ``count`` of them.

    The canvas is one of Agg. Nothing is written before all are drawn. A GIF counts hundredths of a
    second; pictures take turns in length so that the whole keeps its time.
    """
    frames: list[Image.Image] = []
    palette: Image.Image | None = None
    for _ in pictures:
        canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        if palette is None:
            palette = _palette(picture)
        frames.append(picture.quantize(palette=palette, dither=Image.Dither.NONE))
    ends = np.round(100 * np.arange(count + 1) / rate).astype(int)
    buffer = BytesIO()
    frames[0].save(
        buffer,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=[10 * int(hundredths) for hundredths in np.diff(ends)],
        loop=0,
    )
    path.write_bytes(buffer.getvalue())


def _palette(picture: Image.Image) -> Image.Image:
    """Return an image whose palette is that of the picture, with the paper purely white."""
    colors = np.array(picture.quantize(_COLORS).getpalette(), dtype=np.uint8).reshape(-1, 3)
    colors[colors.min(axis=1) >= _NEARLY_WHITE] = 255
    palette = Image.new("P", (1, 1))
    palette.putpalette(colors.ravel().tolist())
    return palette
