"""Data of a rolling gait for C code: the table of its plans."""

from __future__ import annotations

import numpy as np

from tenscontrol.deploy.controllers import LawCode
from tenscontrol.shape.rolling import AHEAD, BACK, FARTHER, FORESEEN, LANDED, RollingGait
from tenscontrol.shape.tipping import CLOSE, MARGIN
from tenscontrol.shape.tipping_table import TINY, TippingTable


def gait_code(gait: RollingGait) -> LawCode:
    """Return the code of a gait; raise ValueError if it plans while it runs."""
    settings = gait.settings
    table, size = settings.plans, settings.plans.size
    if not isinstance(table, TippingTable):
        raise ValueError(
            "controller is a RollingGait that plans while it runs, by equilibria that C code does "
            "not search for: make it by RollingGait(..., tabulated=True)"
        )
    faces = table.faces
    edges = [edge for face in faces for edge in face.edges]
    plans = [plan for face in faces for plan in face.plans]
    known = sorted(set(edges))
    constants: dict[str, int | float] = {
        "FACES": len(faces),
        "EDGES": len(edges),
        "DIFFERENT_EDGES": len(known),
        "STEPS": 0 if np.isinf(settings.steps) else int(settings.steps),
        "FORESEEN": FORESEEN,
        "BACK": BACK,
        "LANDED": LANDED,
        "STILL": settings.still,
        "RESTS": settings.rests,
        "PATIENCE": settings.patience,
        "CLOSE": CLOSE * size,
        "AHEAD": AHEAD * size,
        "ENOUGH": MARGIN * size,
        "ENOUGH_PUSHED": FARTHER * size,
        "TINY": TINY,
    }
    arrays = {
        "up": np.asarray(settings.up),
        "down": np.asarray(table.down),
        "heading": np.asarray(settings.direction),
        "largest_winding": np.asarray(settings.most),
        "foot_start": _starts([len(face.feet) for face in faces]),
        "foot": np.concatenate([face.feet for face in faces]),
        "corner_start": _starts([len(face.corners) for face in faces]),
        "corner": np.concatenate([face.corners for face in faces]),
        "edge_start": _starts([len(face.edges) for face in faces]),
        "edge_node": np.ravel(edges).astype(np.int64),
        "edge_number": np.array([known.index(edge) for edge in edges]),
        "plan_start": _starts([len(margins) for _, margins in plans]),
        "plan_input": np.concatenate([inputs.T.ravel() for inputs, _ in plans]),
        "plan_margin": np.concatenate([margins for _, margins in plans]),
    }
    return LawCode(("gait.c",), constants, arrays, {})


def _starts(counts: list[int]) -> np.ndarray:
    return np.asarray(np.r_[0, np.cumsum(counts)], dtype=np.int64)
