"""The tables and keys of a scene file, with the kind and the unit of each value."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tenscontrol.scene.kinds import (
    BY_STRING,
    COUNT_BY_STRING,
    FORCES,
    NODES,
    NUMBER,
    NUMBERS,
    PAIRS,
    PANELS,
    POINT,
    POINTS,
    TEXT,
    TEXTS,
    TRUTH,
    VECTOR,
    WEIGHT,
    WHOLE,
    Kind,
)

Keys = Mapping[str, tuple[Kind, str]]

# [structure] is one of these two.
PRISM: Keys = MappingProxyType(
    {
        "generator": (TEXT, ""),
        "sides": (WHOLE, ""),
        "radius": (NUMBER, "m"),
        "height": (NUMBER, "m"),
        "top_radius": (NUMBER, "m"),
        "bar_mass": (NUMBERS, "kg"),
        "handedness": (TEXT, ""),
        "fixed": (NODES, ""),
    }
)
MEMBERS: Keys = MappingProxyType(
    {
        "nodes": (POINTS, "m"),
        "bars": (PAIRS, ""),
        "strings": (PAIRS, ""),
        "bar_mass": (NUMBERS, "kg"),
        "string_node_mass": (NUMBERS, "kg"),
        "string_groups": (TEXTS, ""),
        "fixed": (NODES, ""),
    }
)
FORCE: Keys = MappingProxyType({"node": (WHOLE, ""), "force": (POINT, "N")})

TABLES: Mapping[str, Keys] = MappingProxyType(
    {
        "structure": {**PRISM, **MEMBERS},
        "skin": {
            "panels": (PANELS, ""),
            "iterations": (WHOLE, ""),
            "node_mass": (NUMBER, "kg"),
            "panel_mass": (NUMBERS, "kg"),
            "areal_density": (NUMBERS, "kg/m²"),
            "group": (TEXT, ""),
        },
        "subdivide": {
            "segments": (COUNT_BY_STRING, ""),
            "node_mass": (NUMBER, "kg"),
            "string_mass": (BY_STRING, "kg"),
        },
        "strings": {
            "law": (TEXT, ""),
            "stiffness": (BY_STRING, "N/m"),
            "axial_rigidity": (BY_STRING, "N"),
            "damping": (BY_STRING, "N s/m"),
            "per": (TEXT, ""),
        },
        "loads": {"gravity": (VECTOR, "m/s²"), "forces": (FORCES, "")},
        "prestress": {
            "force_density": (BY_STRING, "N/m"),
            "reference": (TEXT, ""),
            "per": (TEXT, ""),
            "shape_gives": (TRUTH, ""),
        },
        "start": {
            "velocities": (POINTS, "m/s"),
            "disturbance": (NUMBER, "m"),
            "seed": (WHOLE, ""),
        },
        "run": {
            "duration": (NUMBER, "s"),
            "step": (NUMBER, "s"),
            "tolerance": (NUMBER, "m and m/s"),
            "output_step": (NUMBER, "s"),
            "method": (TEXT, ""),
            "hold": (TEXT, ""),
        },
        "controller": {
            "kind": (TEXT, ""),
            "input": (TEXT, ""),
            "Q": (WEIGHT, ""),
            "R": (WEIGHT, ""),
            "step": (NUMBER, "s"),
            "sample_time": (NUMBER, "s"),
            "max_force_density": (BY_STRING, "N/m"),
            "horizon": (WHOLE, ""),
            "max_change": (BY_STRING, "N/m"),
            "form": (TEXT, ""),
            "tolerance": (NUMBER, ""),
            "max_iterations": (WHOLE, ""),
        },
        "winches": {
            "rate": (BY_STRING, "m/s"),
            "shortest": (BY_STRING, "m"),
            "longest": (BY_STRING, "m"),
        },
    }
)

# Keys of a table for one choice of its first key; those of the other choice are unknown.
_BOTH = ("kind", "Q", "R", "step", "max_force_density")
LQR: Keys = MappingProxyType(
    {key: TABLES["controller"][key] for key in (*_BOTH, "input", "sample_time")}
)
MPC: Keys = MappingProxyType(
    {
        key: TABLES["controller"][key]
        for key in (*_BOTH, "horizon", "max_change", "form", "tolerance", "max_iterations")
    }
)
LINEAR: Keys = MappingProxyType(
    {key: TABLES["strings"][key] for key in ("law", "stiffness", "damping", "per")}
)
ELASTIC: Keys = MappingProxyType(
    {key: TABLES["strings"][key] for key in ("law", "axial_rigidity", "damping", "per")}
)
