"""Cross sections of the members of a structure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscontrol import validation
from tenscontrol.arrays import FloatArray, frozen
from tenscontrol.sizing.materials import Material
from tenscontrol.structure.structure import Structure


@dataclass(frozen=True, eq=False)
class Sections:
    """Members with a material and a cross section. Made by :func:`sections` and :func:`design`.

    Attributes
    ----------
    structure : Structure
        The structure with the masses of these bars; with those of the strings, where they were
        asked for.
    bars, strings : Material
        What bars and strings are made of.
    bar_area, string_area : ndarray, shape (β,), (α,)
        Area of the cross sections A, m².
    bar_inertia : ndarray, shape (β,)
        Second moment of area I of the bars, m⁴: ``A²/4π`` of a solid round one.
    bar_stress : ndarray, shape (β,)
        Stress that a bar may reach in compression, Pa: the yield stress, or less for a thin wall.
    """

    structure: Structure
    bars: Material
    strings: Material
    bar_area: FloatArray
    string_area: FloatArray
    bar_inertia: FloatArray
    bar_stress: FloatArray

    @property
    def bar_mass(self) -> FloatArray:
        """Mass of each bar, kg, shape (β,)."""
        return self.bars.density * self.bar_area * self.structure.bar_length

    @property
    def string_mass(self) -> FloatArray:
        """Mass of each string in the reference shape, kg, shape (α,)."""
        return self.strings.density * self.string_area * self.structure.string_length()

    @property
    def mass(self) -> float:
        """Mass of bars and strings, kg."""
        return float(self.bar_mass.sum() + self.string_mass.sum())

    @property
    def axial_rigidity(self) -> FloatArray:
        """EA of each string, N, shape (α,): what :class:`ElasticStrings` takes."""
        return self.strings.modulus * self.string_area

    @property
    def bar_axial_rigidity(self) -> FloatArray:
        """EA of each bar, N, shape (β,)."""
        return self.bars.modulus * self.bar_area

    @property
    def buckling_force(self) -> FloatArray:
        """Euler's load of each bar with pinned ends, ``π² E I / l²``, N, shape (β,)."""
        return np.pi**2 * self.bars.modulus * self.bar_inertia / self.structure.bar_length**2

    def margins(self, string_force: object, bar_force: object) -> tuple[FloatArray, FloatArray]:
        """Return how many times the forces each member could carry, strings and bars.

        Parameters
        ----------
        string_force : array_like, shape (α, …)
            Tension of each string, N, such as ``γ L``.
        bar_force : array_like, shape (β, …)
            Force of each bar, N, positive in compression, such as ``λ L``.

        Returns
        -------
        strings : ndarray, shape (α, …)
            ``A σ / T``; infinite without force.
        bars : ndarray, shape (β, …)
            The less of ``A σ / |F|`` and, in compression, Euler's load over F.

        Raises
        ------
        TypeError, ValueError
            If forces do not fit.

        Examples
        --------
        >>> import tenscontrol as tc
        >>> sized = tc.sections(tc.prism(), bars=tc.sizing.materials["aluminium"], bar_radius=0.01,
        ...                     strings=tc.sizing.materials["steel"], string_radius=0.001)
        >>> rest = tc.prestress(tc.prism(), force_density=100.0)
        >>> pull, push = sized.margins(rest.force_density * sized.structure.string_length(),
        ...                            rest.bar_force_density * sized.structure.bar_length)
        >>> round(float(pull.min()), 1), round(float(push.min()), 1)
        (6.2, 11.5)
        """
        pull = _forces("string_force", string_force, len(self.string_area), "string")
        push = _forces("bar_force", bar_force, len(self.bar_area), "bar")
        beside = (slice(None), *[None] * (push.ndim - 1))
        tension = self.bars.yield_stress * self.bar_area
        most = np.minimum(self.bar_stress * self.bar_area, self.buckling_force)
        along = (slice(None), *[None] * (pull.ndim - 1))
        strength = self.strings.yield_stress * self.string_area
        with np.errstate(divide="ignore"):
            of_bars = np.where(push > 0, most[beside], tension[beside]) / np.abs(push)
            of_strings = strength[along] / np.abs(pull)
        return of_strings, of_bars

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.structure!r}, bars {self.bar_mass.sum():.4g} kg, "
            f"strings {self.string_mass.sum():.4g} kg)"
        )


def sections(
    structure: Structure,
    *,
    bars: Material,
    strings: Material,
    bar_radius: object = None,
    string_radius: object = None,
    bar_inner_radius: object = 0.0,
    bar_area: object = None,
    bar_inertia: object = None,
    string_area: object = None,
    string_mass_to_nodes: bool = False,
) -> Sections:
    """Return the members of a structure with materials and cross sections.

    Parameters
    ----------
    structure : Structure
    bars, strings : Material
        What bars and strings are made of.
    bar_radius : float or array_like, shape (β,)
        Radius of each bar, m, the outer one of a tube.
    string_radius : float or array_like, shape (α,)
        Radius of each string, m.
    bar_inner_radius : float or array_like, shape (β,), optional
        Inner radius of tubes, m; 0 for solid bars.
    bar_area, bar_inertia : float or array_like, shape (β,), optional
        Area, m², and the least second moment of area, m⁴, of bars of any other cross section, in
        place of radii. Without the latter, that of a solid round bar.
    string_area : float or array_like, shape (α,), optional
        Area, m², in place of ``string_radius``: of a rope, that of its fibres or wires.
    string_mass_to_nodes : bool, optional
        Adds half the mass of each segment of a string to either end, as a point mass of the
        structure. Without, strings have no mass in the motion; :func:`subdivide` gives them
        nodes of their own.

    Returns
    -------
    Sections
        Its ``structure`` has the masses, its ``axial_rigidity`` goes to :class:`ElasticStrings`.

    Raises
    ------
    TypeError, ValueError
        If a value does not fit or is not positive, a tube's inner radius is not below its outer
        one, or both or neither of radius and area are given.

    Examples
    --------
    From radii to a model and the rest lengths that hold a prestress:

    >>> import tenscontrol as tc
    >>> sized = tc.sections(
    ...     tc.prism(), bars=tc.sizing.materials["aluminium"], bar_radius=0.01,
    ...     strings=tc.Material(modulus=2e9, density=1100, yield_stress=80e6), string_radius=1e-3)
    >>> sized.bar_mass.round(3), round(float(sized.axial_rigidity[0]))
    (array([1.179, 1.179, 1.179]), 6283)
    >>> model = tc.Model(sized.structure, tc.ElasticStrings(sized.axial_rigidity))
    >>> rest = tc.prestress(sized.structure, force_density=100.0)
    >>> wound = tc.to_rest_length(model, rest.structure.nodes, rest.force_density)
    >>> wound.rest_length.round(3)[[0, 3, 6]]
    array([0.854, 0.854, 1.004])
    """
    validation.instance("structure", structure, Structure, "make one by Structure(...)")
    for name, value in (("bars", bars), ("strings", strings)):
        _material(name, value)
    validation.truth(
        "string_mass_to_nodes", string_mass_to_nodes, "whether nodes get the mass of strings"
    )
    alpha, beta = len(structure.strings), len(structure.bars)
    A_s = _area("string", string_radius, string_area, alpha)
    hollow = validation.per_member("bar_inner_radius", bar_inner_radius, beta, "bar")
    validation.non_negative("bar_inner_radius", hollow, "m, 0 for a solid bar")
    A_b = _area("bar", bar_radius, bar_area, beta)
    inertia = A_b**2 / (4 * np.pi)
    if bar_radius is not None:
        if bar_inertia is not None:
            raise ValueError("bar_inertia goes with bar_area; a radius gives its own")
        outer = validation.per_member("bar_radius", bar_radius, beta, "bar")
        if (hollow >= outer).any():
            i = int((hollow >= outer).argmax())
            raise ValueError(
                f"bar_inner_radius[{i}] is {hollow[i]:g} m, expected less than bar_radius[{i}], "
                f"{outer[i]:g} m"
            )
        A_b, inertia = np.pi * (outer**2 - hollow**2), np.pi / 4 * (outer**4 - hollow**4)
    elif hollow.any():
        raise ValueError("bar_inner_radius goes with bar_radius; give bar_inertia with bar_area")
    elif bar_inertia is not None:
        inertia = validation.per_member("bar_inertia", bar_inertia, beta, "bar")
        validation.positive("bar_inertia", inertia, "second moment of area in m⁴")
    stress = np.full(beta, bars.yield_stress)
    return with_areas(structure, bars, strings, A_b, A_s, inertia, stress, string_mass_to_nodes)


def with_areas(
    structure: Structure, bars: Material, strings: Material, bar_area: FloatArray,
    string_area: FloatArray, inertia: FloatArray, stress: FloatArray, is_lumped: bool,
) -> Sections:  # fmt: skip
    """Return sections of checked areas, and the structure with their masses."""
    return Sections(
        _massive(structure, bars, strings, bar_area, string_area, is_lumped),
        bars, strings, frozen(bar_area), frozen(string_area), frozen(inertia), frozen(stress),
    )  # fmt: skip


def _massive(
    structure: Structure, bars: Material, strings: Material, bar_area: FloatArray,
    string_area: FloatArray, is_lumped: bool,
) -> Structure:  # fmt: skip
    """Return the structure with the masses of its sections."""
    points = structure.point_mass.copy()
    if is_lumped:
        pieces = np.linalg.norm(structure.string_vectors(structure.nodes), axis=0)
        half = 0.5 * strings.density * string_area[structure.segment_string] * pieces
        for end in structure.segments.T:
            points += np.bincount(end, half, minlength=len(points))
    return Structure(
        structure.nodes, structure.bars, structure.paths or structure.strings,
        bars.density * bar_area * structure.bar_length,
        string_groups=structure.string_groups, fixed=structure.fixed, rollers=structure.rollers,
        parent=structure.parent, string_parent=structure.string_parent, point_mass=points,
    )  # fmt: skip


def _area(member: str, radius: object, area: object, count: int) -> FloatArray:
    """Return the area of each member, as of solid round ones where a radius is given."""
    if (radius is None) == (area is None):
        both = "both are given" if radius is not None else "none is given"
        raise ValueError(f"expected {member}_radius or {member}_area, {both}")
    if area is not None:
        values = validation.per_member(f"{member}_area", area, count, member)
        return validation.positive(f"{member}_area", values, "area in m²")
    values = validation.per_member(f"{member}_radius", radius, count, member)
    return np.pi * validation.positive(f"{member}_radius", values, "radius in m") ** 2


def _material(name: str, value: object) -> None:
    validation.instance(
        name, value, Material, "make one by Material(modulus=…, density=…, yield_stress=…)"
    )


def _forces(name: str, value: Any, count: int, member: str) -> FloatArray:
    array = validation.float_array(name, value)
    if array.ndim == 0 or len(array) != count:
        raise ValueError(f"{name} has shape {array.shape}, expected {count} rows, one per {member}")
    return array
