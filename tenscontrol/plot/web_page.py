"""A web page with a structure, a motion or modes, to be turned by the mouse.

The page is one file that needs no network: plotly.js is part of it. Only here is plotly used. The
figure is made here; ``web_page.js`` moves it.
"""

from __future__ import annotations

import json
import re
from base64 import b64encode
from dataclasses import dataclass
from html import escape
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, IntArray
from tenscontrol.files import write_file
from tenscontrol.properties import cached_property
from tenscontrol.structure.structure import Structure

# What a page holds at most: states of a motion, and numbers, of 4 bytes each. A notebook holds
# fewer, as text: some 8 bytes a number.
_MOST_FRAMES, _MOST_NUMBERS = 600, 3_000_000
_MOST_NOTEBOOK_FRAMES, _MOST_NOTEBOOK_NUMBERS = 60, 150_000

# A string below this part of the largest force density carries nothing.
_SLACK = 1e-9

# What is drawn behind others in the plane is as far from them, as a part of the size.
_BEHIND = 0.01

# Room around the nodes and the least extent of the box, as parts of its largest extent.
_MARGIN, _THINNEST = 0.06, 0.2

# Most height of the box, in units of plotly, for the eye to see all of it.
_TALLEST = 1.3

# Modes: the largest displacement at first, and the most of the slider, as parts of the size.
_AMPLITUDE, _MOST_AMPLITUDE = 0.1, 0.2

# Much is dark, in grey print too: cividis without its lightest colours.
_COLORS = ["#d3c164", "#b3a772", "#948e77", "#7c7b78", "#666970", "#4e576c", "#2a406c", "#00224e"]

# The colours of both strings and bars.
_SHARE = "force over strength"

_INK, _STRING, _SLACK_COLOR, _FAINT = "#262626", "#0072b2", "#8c8c8c", "#cfcfcf"
_PASSIVE, _PRESSED = "#009e73", "#d55e00"

# Bars whose lengths are driven, and their width as part of that of others.
_STRUT, _STRUT_WIDTH = "#7f7f7f", 0.7

# Bars are wide and dark, strings thin, pixels; both thinner where there are many.
_BAR_WIDTH, _STRING_WIDTH, _NODE_SIZE, _FEW, _LEAST_SHARE = 10.0, 4.0, 5.0, 60, 0.35

_HEIGHT = 640  # pixels in a notebook


@dataclass(frozen=True, eq=False)
class View:
    """What is turned in a browser. Made by :func:`tenscontrol.plot.view`.

    The page is one HTML file of some 5 MB, most of it plotly.js, and needs no network. A long
    motion is thinned out to 600 states, one of a large structure to as many as make 3 million
    numbers. Modes are the first, as many as make as many.

    Attributes
    ----------
    what : str
        Such as "10 modes".
    members : Structure
        What joins the nodes.
    nodes : ndarray, shape (d, n, T)
        Node positions of the states shown, m.
    time : ndarray, shape (T,), or None
        s; None where nothing moves by itself.
    force_density : ndarray, shape (α, T), or None
        γ, N/m, which strings are coloured by.
    shapes : ndarray, shape (d, n, k), or None
        Mode shapes, real or complex, the largest displacement 1.
    labels : tuple of str
        What the modes are called.
    ground : tuple of ndarray, shape (d, a, b)
        Points of each ground, on a grid; of a line in the plane, b = 1.
    pressed : ndarray of bool, shape (n, T), or None
        Whether the ground presses on a node.
    share : ndarray, shape (α + β, T), or None
        Force over strength, which strings and bars are coloured by.
    passive : ndarray of bool, shape (α,), or None
        Whether a string is one that no winch drives: dashed.
    struts : ndarray of bool, shape (β,), or None
        Whether the length of a bar is driven: grey, and slimmer.
    """

    what: str
    members: Structure
    nodes: FloatArray
    time: FloatArray | None = None
    force_density: FloatArray | None = None
    shapes: np.ndarray | None = None
    labels: tuple[str, ...] = ()
    ground: tuple[FloatArray, ...] = ()
    pressed: np.ndarray | None = None
    share: FloatArray | None = None
    passive: np.ndarray | None = None
    struts: np.ndarray | None = None

    def __post_init__(self) -> None:
        """Refuse what is not finite: a motion that ran away."""
        validation.float_array("nodes", self.nodes)
        if self.force_density is not None:
            validation.float_array("force_density", self.force_density)
        if self.share is not None:
            validation.float_array("share", self.share)

    # ---- what users call ----

    def save(self, path: str | PathLike[str]) -> Path:
        """Write the page and return its path.

        Parameters
        ----------
        path : str or path
            Where to write; ends in ``.html``. A file that is there is replaced.

        Raises
        ------
        TypeError, ValueError
            If ``path`` is no path, or does not end in ``.html``.
        ImportError
            If plotly is not installed: the extra ``view``.
        OSError
            If the file cannot be written: a file that was there is as it was.
        """
        return write_file(validation.file_path("path", path, [".html", ".htm"]), self.html())

    def html(self) -> str:
        """Return the page as text.

        Raises
        ------
        ImportError
            If plotly is not installed: the extra ``view``.
        """
        parts = {
            "TITLE": escape(self.title),
            "COLORS": ", ".join(_COLORS),
            "SPEC": json.dumps(self._spec(), allow_nan=False).replace("</", "<\\/"),
            "SCRIPT": _text("web_page.js"),
            "PLOTLY": plotly_js(),
        }
        return re.sub(
            f"@({'|'.join(parts)})@", lambda match: parts[match[1]], _text("web_page.html")
        )

    def open(self) -> Path:
        """Write the page to a temporary file, show it in the browser, and return its path.

        Raises
        ------
        ImportError
            If plotly is not installed: the extra ``view``.
        """
        import tempfile
        import webbrowser

        path = self.save(Path(tempfile.mkdtemp(prefix="tenscontrol-")) / "view.html")
        webbrowser.open(path.as_uri())
        return path

    def _repr_html_(self) -> str:
        """Return the page for Jupyter, in a frame of its own."""
        page = escape(self.html())
        return f'<iframe srcdoc="{page}" width="100%" height="{_HEIGHT}" frameborder="0"></iframe>'

    @property
    def title(self) -> str:
        """What is shown, with its size."""
        counts = {
            "node": self.nodes.shape[1],
            "bar": len(self.members.bars),
            "string": len(self.members.strings),
        }
        size = ", ".join(f"{count} {name}{'s' * (count != 1)}" for name, count in counts.items())
        return f"{self.what}: {size}"

    def __repr__(self) -> str:
        return f"View({self.title!r})"

    # ---- the figure ----

    @property
    def _dimension(self) -> int:
        return len(self.nodes)

    @cached_property
    def _kept(self) -> IntArray:
        """The states of the page: all, or as many as it may hold, evenly."""
        per_frame = self.nodes[:, :, 0].size + len(self.members.strings)
        per_frame += 0 if self.share is None else len(self.share)
        return self._thinned(min(_MOST_FRAMES, _MOST_NUMBERS // per_frame))

    def _thinned(self, most: int) -> IntArray:
        count, most = self.nodes.shape[2], max(2, most)
        return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))

    @cached_property
    def _size(self) -> float:
        """Largest extent of the first shape, m."""
        return float(np.ptp(self.nodes[:, :, 0], axis=1).max())

    @cached_property
    def _least(self) -> float:
        """The force density up to which a string is slack, N/m."""
        gamma = self.force_density
        return _SLACK * (0.0 if gamma is None else float(gamma.max(initial=0.0)))

    @cached_property
    def _is_slack(self) -> np.ndarray:
        """Which strings carry nothing, bool, shape (α, T)."""
        if self.force_density is None:
            return np.zeros((len(self.members.strings), self.nodes.shape[2]), dtype=bool)
        return np.asarray(self.force_density <= self._least)

    @cached_property
    def _tension(self) -> FloatArray | None:
        """γ times length, N, shape (α, kept)."""
        if self.force_density is None:
            return None
        kept, (start, end) = self.nodes[:, :, self._kept], self.members.segments.T
        lengths = np.linalg.norm(kept[:, end] - kept[:, start], axis=0)
        firsts = np.searchsorted(self.members.segment_string, np.arange(len(self.members.strings)))
        whole = np.add.reduceat(lengths, firsts, axis=0) if len(firsts) else lengths
        return np.asarray(self.force_density[:, self._kept] * whole)

    def _spec(self) -> dict[str, Any]:
        """Return all that the page is made of, as JSON has it."""
        gamma, tension = self.force_density, self._tension
        modes = max(1, _MOST_NUMBERS // (2 * self.nodes[:, :, 0].size))
        colors, share = {}, self.share
        if share is not None and share.size:
            colors[_SHARE] = max(1.0, float(share[:, self._kept].max()))
        if gamma is not None and tension is not None and gamma.size:
            colors["tension, N"] = float(tension.max())
            colors["force density γ, N/m"] = float(gamma[:, self._kept].max())
        return {
            "scale": [[k / (len(_COLORS) - 1), color] for k, color in enumerate(_COLORS)],
            "figure": {"data": self._traces(), "layout": self._layout() | {"showlegend": False}},
            "index": self._index,
            "dimension": self._dimension,
            "size": self._size,
            "nodes": _packed(self.nodes[:, :, self._kept].transpose(2, 1, 0)),
            "time": None if self.time is None else self.time[self._kept].tolist(),
            "gamma": None if gamma is None else _packed(gamma[:, self._kept].T),
            "share": None if share is None else _packed(share[:, self._kept].T),
            "shareName": _SHARE,
            "slack": self._least,
            "segments": self.members.segments.tolist(),
            "segmentString": self.members.segment_string.tolist(),
            "passive": None if self.passive is None else self.passive.tolist(),
            "colors": colors,
            "pressed": self._pressed_nodes,
            "labels": list(self.labels[:modes]),
            "real": None if self.shapes is None else _packed(self._at_largest[:modes].real),
            "imaginary": None if self.shapes is None else _packed(self._at_largest[:modes].imag),
            "amplitude": _AMPLITUDE,
            "mostAmplitude": _MOST_AMPLITUDE,
        }

    @cached_property
    def _at_largest(self) -> np.ndarray:
        """Mode shapes, (k, n, d), each at the phase at which its real part is largest."""
        assert self.shapes is not None  # asked for of modes only
        phase = 0.5 * np.angle((self.shapes**2).sum(axis=(0, 1)))
        turned = self.shapes * np.exp(-1j * phase)
        largest = np.linalg.norm(turned.real, axis=0).max(axis=0, initial=0.0)
        return np.asarray((turned / np.where(largest > 0, largest, 1.0)).transpose(2, 1, 0))

    @cached_property
    def _pressed_nodes(self) -> list[list[int]] | None:
        if self.pressed is None:
            return None
        return [np.flatnonzero(self.pressed[:, k]).tolist() for k in self._kept]

    @cached_property
    def _index(self) -> dict[str, list[int]]:
        """The node at each point of a trace, −1 where its line breaks."""
        held = [*self.members.fixed.tolist(), *(node for node, _ in self.members.rollers)]
        return {
            "strings": _lines(self.members.segments),
            **self._bar_index,
            "nodes": list(range(self.nodes.shape[1])),
            "supports": sorted(set(held)),
        }

    @cached_property
    def _bar_index(self) -> dict[str, list[int]]:
        """The same of the traces of bars: of those that are driven, too, if any are."""
        every = _lines(self.members.bars)
        if self.struts is None:
            return {"bars": every}
        driven, index = np.repeat(self.struts, 3), np.array(every, dtype=np.int64)
        kinds = {"bars": ~driven, "driven bars": driven}
        return {name: np.where(kind, index, -1).tolist() for name, kind in kinds.items()}

    def _shape(self, state: int) -> FloatArray:
        """Return node positions, (3, n + 1): the last is none, where lines break."""
        nodes = np.full((3, self.nodes.shape[1] + 1), np.nan)
        nodes[2, :-1] = 0.0
        nodes[: self._dimension, :-1] = self.nodes[:, :, state]
        return nodes

    def _traces(self) -> list[dict[str, Any]]:
        """Return the traces of the first state; the script finds them by name."""
        count = len(self.members.bars) + len(self.members.segments)
        share = min(1.0, max(_LEAST_SHARE, (_FEW / count) ** 0.5))
        width, nodes = share * _STRING_WIDTH, self._shape(0)
        taut, slack, *passive = self._strings(0)
        base: dict[str, Any] = {"type": "scatter3d", "mode": "lines", "hoverinfo": "skip"}
        dots: dict[str, Any] = {"type": "scatter3d", "mode": "markers"}
        axes = "xyz"[: self._dimension]
        coordinates = "<br>".join(f"{axis} %{{{axis}:.4g}} m" for axis in axes)
        traces = [
            base
            | {
                "name": "strings" if self.passive is None else "driven strings",
                **taut,
                "line": {"color": _STRING, "width": width},
                "showlegend": self.passive is None or not self.passive.all(),
            },
            base
            | {
                "name": "slack strings",
                **slack,
                "line": {"color": _SLACK_COLOR, "width": width, "dash": "dot"},
                "showlegend": bool(self._is_slack.any()),
            },
            *(
                base
                | {
                    "name": "passive strings",
                    **springs,
                    "line": {"color": _PASSIVE, "width": width, "dash": "dash"},
                }
                for springs in passive
            ),
            *(
                base
                | {
                    "name": name,
                    **_at(nodes, index),
                    "line": {"color": color, "width": thickness * share * _BAR_WIDTH},
                    "showlegend": max(index, default=-1) >= 0,
                }
                for (name, index), (color, thickness) in zip(
                    self._bar_index.items(), ((_INK, 1.0), (_STRUT, _STRUT_WIDTH)), strict=False
                )
            ),
            dots
            | {
                "name": "nodes",
                **_at(nodes, self._index["nodes"]),
                "text": [str(node) for node in self._index["nodes"]],
                "textfont": {"size": 14, "color": _PRESSED},
                "hovertemplate": f"node %{{text}}<br>{coordinates}<extra></extra>",
                "marker": {"color": _INK, "size": share * _NODE_SIZE},
            },
            dots
            | {
                "name": "supports",
                **_at(nodes, self._index["supports"]),
                "hoverinfo": "skip",
                "marker": {
                    "color": _INK,
                    "size": 2 * share * _NODE_SIZE,
                    "symbol": "diamond-open",
                },
                "showlegend": bool(self._index["supports"]),
            },
            dots
            | {
                "name": "on the ground",
                **_at(nodes, self._pressed_nodes[0] if self._pressed_nodes else []),
                "hoverinfo": "skip",
                "marker": {"color": _PRESSED, "size": 1.8 * share * _NODE_SIZE, "symbol": "square"},
                "showlegend": self._pressed_nodes is not None,
            },
        ]
        if self.shapes is not None:
            at_rest = self._index["strings"] + _lines(self.members.bars)
            if self._dimension == 2:
                nodes[2] -= _BEHIND * self._size
            line = {"color": _FAINT, "width": width}
            traces.append(base | {"name": "at rest", **_at(nodes, at_rest), "line": line})
        return traces + [self._ground_trace(grid) for grid in self.ground]

    def _strings(self, state: int) -> list[dict[str, Any]]:
        """Return the points of taut and of slack strings in a state, and of passive ones if any."""
        index = np.array(self._index["strings"], dtype=np.int64)
        slack = np.repeat(self._is_slack[self.members.segment_string, state], 3)
        kinds = [~slack, slack]
        if self.passive is not None:
            passive = np.repeat(self.passive[self.members.segment_string], 3)
            kinds = [~slack & ~passive, slack, ~slack & passive]
        nodes = self._shape(state)
        return [_at(nodes, np.where(kind, index, -1)) for kind in kinds]

    def _ground_trace(self, grid: FloatArray) -> dict[str, Any]:
        if self._dimension == 2:
            points = np.vstack([grid[:, :, 0], np.full(grid.shape[1], -_BEHIND * self._size)])
            line = {"color": "#9a9a9a", "width": 4}
            look: dict[str, Any] = {"type": "scatter3d", "mode": "lines", "line": line}
        else:
            points = grid.reshape(3, -1)
            numbers = np.arange(points.shape[1]).reshape(grid.shape[1:])
            corners = [numbers[:-1, :-1], numbers[1:, :-1], numbers[:-1, 1:], numbers[1:, 1:]]
            low, right, up, high = (corner.ravel() for corner in corners)
            triangles = np.hstack([[low, right, up], [right, high, up]]).tolist()
            look = {"type": "mesh3d", "color": "#bdbdbd", "opacity": 0.45}
            look |= dict(zip("ijk", triangles, strict=True))
        values = {axis: row.tolist() for axis, row in zip("xyz", points, strict=True)}
        return look | values | {"name": "ground", "hoverinfo": "skip", "showlegend": True}

    def _box(self) -> FloatArray:
        """Return the limits of the axes, (3, 2)."""
        lower, upper = self.nodes.min(axis=(1, 2)), self.nodes.max(axis=(1, 2))
        if self.shapes is not None:
            reach = _MOST_AMPLITUDE * self._size * np.abs(self._at_largest).max(axis=0).T
            rest = self.nodes[:, :, 0]
            lower, upper = (rest - reach).min(axis=1), (rest + reach).max(axis=1)
        for grid in self.ground:
            points = grid.reshape(self._dimension, -1)
            lower, upper = (
                np.minimum(lower, points.min(axis=1)),
                np.maximum(upper, points.max(axis=1)),
            )
        box = np.zeros((3, 2))
        box[: self._dimension] = np.stack([lower, upper], axis=1)
        centre, half = box.mean(axis=1), np.ptp(box, axis=1) / 2
        largest = max(float(half.max()), 1e-9)
        half = np.maximum(half + _MARGIN * largest, _THINNEST * largest)
        return np.stack([centre - half, centre + half], axis=1)

    def _layout(self) -> dict[str, Any]:
        box = self._box()
        extent = np.ptp(box, axis=1)
        is_flat = self._dimension == 2
        # Nearly as large as the eye sees from where it is, in the middle of a window.
        aspect = extent * min(np.sqrt(3.0) / np.linalg.norm(extent), _TALLEST / extent[2])
        camera: dict[str, Any] = {
            "eye": {"x": 0.95, "y": -1.7, "z": 0.65},
            "center": {"x": 0.0, "y": 0.0, "z": -0.05},
        }
        if is_flat:
            aspect = 1.5 * extent / extent.max()
            camera = {
                "eye": {"x": 0.0, "y": 0.0, "z": 1.6},
                "up": {"x": 0.0, "y": 1.0, "z": 0.0},
                "projection": {"type": "orthographic"},
            }
        grey = {"gridcolor": "#e4e4e4", "showspikes": False, "zeroline": False}
        scene: dict[str, Any] = {
            "aspectmode": "manual",
            "aspectratio": dict(zip("xyz", aspect.tolist(), strict=True)),
            "camera": camera,
            "dragmode": "pan" if is_flat else "turntable",
        }
        for axis, limits in zip("xyz", box.tolist(), strict=True):
            look = {"title": {"text": f"{axis}, m"}, "range": limits, "showbackground": False}
            scene[f"{axis}axis"] = grey | look | ({"tickangle": 0} if is_flat else {})
        if is_flat:
            scene["zaxis"] = {"visible": False, "range": box[2].tolist()}
        return {
            "scene": scene,
            "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
            "legend": {"x": 0.01, "y": 0.99, "bgcolor": "rgba(255,255,255,0.7)"},
            "paper_bgcolor": "white",
        }

    # ---- notebooks ----

    def figure(self) -> dict[str, Any]:
        """Return the figure as plotly's JSON, for Jupyter: of a motion at most 60 states.

        Of modes, a slider chooses one; its largest displacement is a tenth of the size.

        Returns
        -------
        dict
            ``data``, ``layout`` and ``frames``, of lists and numbers.
        """
        layout = self._layout() | {"height": _HEIGHT, "title": {"text": self.title}}
        layout["margin"] |= {"t": 40, "b": 40}
        figure: dict[str, Any] = {"data": self._traces(), "layout": layout}
        most = _MOST_NOTEBOOK_NUMBERS // (9 * (len(self.members.bars) + len(self.members.segments)))
        if self.shapes is not None:
            count = min(len(self.labels), max(most, 1), _MOST_NOTEBOOK_FRAMES)
            shown = [self._displaced(mode) for mode in range(count)]
            names, label = list(self.labels[: len(shown)]), "mode "
        elif self.time is not None and self.nodes.shape[2] > 1:
            states = self._thinned(min(_MOST_NOTEBOOK_FRAMES, most))
            shown = [self._moved(state) for state in states]
            names, label = [f"{self.time[state]:.4g}" for state in states], "time, s: "
        else:
            return dict(_rounded(figure))
        figure["frames"] = [
            {
                "name": str(k),
                "data": [{"type": "scatter3d"} | trace for trace in data],
                "traces": list(range(len(data))),
            }
            for k, data in enumerate(shown)
        ]
        play: dict[str, Any] = {"mode": "immediate", "frame": {"duration": 50, "redraw": True}}
        steps = [
            {"label": name, "method": "animate", "args": [[str(k)], play]}
            for k, name in enumerate(names)
        ]
        layout["sliders"] = [{"steps": steps, "currentvalue": {"prefix": label}, "pad": {"l": 90}}]
        if self.shapes is None:
            buttons = [
                {
                    "label": "play",
                    "method": "animate",
                    "args": [None, play | {"fromcurrent": True}],
                },
                {"label": "pause", "method": "animate", "args": [[None], play]},
            ]
            position = {"x": 0.0, "y": 0.0, "xanchor": "left", "yanchor": "top", "pad": {"t": 30}}
            layout["updatemenus"] = [{"type": "buttons", "buttons": buttons, **position}]
        return dict(_rounded(figure))

    def _moved(self, state: int) -> list[dict[str, Any]]:
        """Return the traces that move, in a state."""
        nodes = self._shape(state)
        lines = [*self._strings(state), *(_at(nodes, bars) for bars in self._bar_index.values())]
        return [*lines, *(_at(nodes, self._index[name]) for name in ("nodes", "supports"))]

    def _displaced(self, mode: int) -> list[dict[str, Any]]:
        nodes = self._shape(0)
        moved = _AMPLITUDE * self._size * self._at_largest[mode].real.T
        nodes[: self._dimension, :-1] += moved
        lines = [
            _at(nodes, self._index["strings"]),
            _at(nodes, []),
            _at(nodes, self._index["bars"]),
        ]
        return [*lines, *(_at(nodes, self._index[name]) for name in ("nodes", "supports"))]


def _text(name: str) -> str:
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def plotly_js() -> str:
    """Return the library that draws, or say how to get it."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise ImportError(
            "a view needs the package plotly, which is not installed: "
            "pip install 'tenscontrol[view]'"
        ) from error
    return str(get_plotlyjs())


def _packed(values: np.ndarray) -> str:
    """Return numbers as base64 of little-endian floats of 4 bytes."""
    return b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def _lines(pairs: IntArray) -> list[int]:
    """Return the nodes of lines of one trace, with a break after each."""
    return np.hstack([pairs, np.full((len(pairs), 1), -1)]).ravel().tolist()


def _at(nodes: FloatArray, index: object) -> dict[str, Any]:
    """Return the coordinates of a trace, of nodes with a point that is none at the end."""
    points = nodes[:, np.asarray(index, dtype=np.int64)]
    return {
        axis: [None if np.isnan(value) else value for value in row.tolist()]
        for axis, row in zip("xyz", points, strict=True)
    }


def _rounded(value: Any) -> Any:
    """Return JSON with numbers of six digits, which nobody can see the difference of."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value
