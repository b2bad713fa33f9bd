"""The tables and keys of a scene file, with the kind and the unit of each value."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tenscontrol.scene.kinds import (
    BY_STRING,
    COUNT_BY_STRING,
    FORCES,
    INDICES,
    NODES,
    NUMBER,
    NUMBERS,
    PAIRS,
    PANELS,
    POINT,
    POINTS,
    TABLES_OF_KEYS,
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
        "diagonals": (TRUTH, ""),
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
            "input": (TEXT, ""),
            "sample_time": (NUMBER, "s"),
        },
        "controller": {
            "kind": (TEXT, ""),
            "input": (TEXT, ""),
            "Q": (WEIGHT, ""),
            "R": (WEIGHT, ""),
            "sample_time": (NUMBER, "s"),
            "max_force_density": (BY_STRING, "N/m"),
            "min_force_density": (BY_STRING, "N/m"),
            "max_tension": (BY_STRING, "N"),
            "max_change": (BY_STRING, "N/m or m"),
            "horizon": (WHOLE, ""),
            "form": (TEXT, ""),
            "iterations": (WHOLE, ""),
            "frequency": (NUMBER, "Hz"),
            "damping": (NUMBER, ""),
            "regularization": (NUMBER, ""),
            "string_penalty": (NUMBER, ""),
            "load_gain": (NUMBER, ""),
            "tracked": (TABLES_OF_KEYS, ""),
            "outputs": (TABLES_OF_KEYS, ""),
            "reference": (TABLES_OF_KEYS, ""),
            "tolerance": (NUMBER, ""),
            "max_iterations": (WHOLE, ""),
            "time_limit": (NUMBER, "s"),
            "plants": (WHOLE, ""),
        },
        "winches": {
            "rate": (BY_STRING, "m/s"),
            "shortest": (BY_STRING, "m"),
            "longest": (BY_STRING, "m"),
            "ramp": (TRUTH, ""),
            "substeps": (WHOLE, ""),
        },
        "sensors": {
            "node_position": (NUMBERS, "m"),
            "string_length": (NUMBERS, "m"),
            "bar_direction": (NUMBERS, ""),
            "string_tension": (NUMBERS, "N"),
            "nodes": (NODES, ""),
            "strings": (INDICES, ""),
            "bars": (INDICES, ""),
            "tension_strings": (INDICES, ""),
            "delay": (WHOLE, ""),
            "drop_rate": (NUMBER, ""),
            "outlier_rate": (NUMBER, ""),
            "seed": (WHOLE, ""),
        },
        "estimator": {
            "kind": (TEXT, ""),
            "process_noise": (NUMBER, ""),
            "load": (TRUTH, ""),
            "load_noise": (NUMBER, ""),
            "prediction": (TEXT, ""),
            "gate": (NUMBER, ""),
            "patience": (WHOLE, ""),
            "start_spread": (NUMBER, ""),
        },
        "faults": {
            "kind": (TEXT, ""),
            "string": (WHOLE, ""),
            "time": (NUMBER, "s"),
            "until": (NUMBER, "s"),
        },
    }
)

# Keys, and values of keys, by the way to them: what older files call them, and what to write.
RENAMED: Mapping[tuple[str, ...], str] = MappingProxyType(
    {
        ("controller", "step"): "sample_time",
        ("controller", "kind", "shape_control"): "feedback_linearization",
        ("run", "hold"): "input",
        ("winches", "pieces"): "substeps",
    }
)

# Those of which a file has a list, each with a heading like [[faults]].
LISTS = ("faults",)

# Entries of [[controller.tracked]], [[controller.outputs]] and [[controller.reference]].
TRACKED: Keys = MappingProxyType(
    {"node": (WHOLE, ""), "relative_to": (WHOLE, ""), "axis": (TEXT, "")}
)
OUTPUT: Keys = MappingProxyType(
    {
        **TRACKED,
        "low": (NUMBER, "m"),
        "high": (NUMBER, "m"),
        "penalty": (NUMBER, "1/m"),
    }
)
WAYPOINT: Keys = MappingProxyType(
    {
        "start": (NUMBER, "s"),
        "time": (NUMBER, "s"),
        "height": (NUMBER, "m"),
        "twist": (NUMBER, "rad"),
        "top": (NODES, ""),
        "bottom": (NODES, ""),
        "nodes": (NODES, ""),
        "positions": (POINTS, "m"),
        "force_density": (NUMBER, "N/m"),
    }
)


def _controller(*names: str) -> Keys:
    shared = ("kind", "input", "sample_time", "max_force_density")
    return MappingProxyType({key: TABLES["controller"][key] for key in (*shared, *names)})


_SOLVED = ("max_change", "tolerance", "max_iterations", "reference")
_LIMITED = ("min_force_density", "max_tension", "outputs", "string_penalty", "time_limit")
_PREDICTED = ("Q", "R", "horizon", "load_gain", "tracked", *_SOLVED, *_LIMITED)
# Keys of a table for one choice of its first key; those of the other choices are unknown.
CONTROLLERS: Mapping[str, Keys] = MappingProxyType(
    {
        "lqr": _controller("Q", "R", "max_change"),
        "mpc": _controller(*_PREDICTED, "form", "plants"),
        "nmpc": _controller(*_PREDICTED, "iterations"),
        "feedback_linearization": _controller(
            *_SOLVED, "frequency", "damping", "regularization", "tracked"
        ),
    }
)
LINEAR: Keys = MappingProxyType(
    {key: TABLES["strings"][key] for key in ("law", "stiffness", "damping", "per")}
)
ELASTIC: Keys = MappingProxyType(
    {key: TABLES["strings"][key] for key in ("law", "axial_rigidity", "damping", "per")}
)


def _fault(*names: str) -> Keys:
    return MappingProxyType({key: TABLES["faults"][key] for key in ("kind", "time", *names)})


FAULTS: Mapping[str, Keys] = MappingProxyType(
    {
        "cut_string": _fault("string"),
        "stuck_winch": _fault("string", "until"),
        "lost_measurement": _fault("until"),
    }
)
