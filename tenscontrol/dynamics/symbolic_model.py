"""Symbols and matrices of N̈ M_s + N K_s = W, as the paper writes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

# CasADi expressions carry no types of their own.
Symbolic = Any


@dataclass(frozen=True, eq=False)
class SymbolicModel:
    """The equation of motion ``N̈ M_s + N K_s = W`` in CasADi's SX. Made by :meth:`Model.symbolic`.

    It holds where supports leave nodes free; elsewhere the two sides differ by their reactions.

    Attributes
    ----------
    x : SX, shape (2f, 1)
        The state, ``[vec(N); vec(Ṅ)]`` of what supports leave free: a pure symbol.
    N, Nd : SX, shape (d, n)
        Positions, m, and velocities, m/s, of all nodes, made of ``x``; pure symbols without
        supports.
    Ndd : SX, shape (d, n)
        N̈, m/s², written out without an inverse.
    gamma : SX, shape (α, 1)
        γ of each string, N/m: a symbol, or an expression of rest lengths and the string law.
    rest_length : SX, shape (α, 1), or None
        Symbols l0, m, where rest lengths are the input.
    lam : SX, shape (β, 1)
        λ of each bar, N/m, positive in compression.
    W : SX, shape (d, n)
        Weights, loads and forces of the ground on the nodes, N.
    load : SX, shape (d, n), or None
        The symbols in W, where the model takes a load.
    M_s, K_s : SX, shape (n, n)
        Mass matrix, kg, and stiffness matrix, N/m: eqs. (8) and (9), columns by node.
    parameters : mapping of str to SX
        The symbols that were asked for: ``"bar_mass"``, kg, ``"stiffness"``, N/m, and so on.
    """

    x: Symbolic
    N: Symbolic
    Nd: Symbolic
    Ndd: Symbolic
    gamma: Symbolic
    rest_length: Symbolic
    lam: Symbolic
    W: Symbolic
    load: Symbolic
    M_s: Symbolic
    K_s: Symbolic
    parameters: Mapping[str, Symbolic]

    def __repr__(self) -> str:
        d, n = self.N.shape
        names = f", symbols {', '.join(self.parameters)}" if self.parameters else ""
        inputs = "force_density" if self.rest_length is None else "rest_length"
        return f"SymbolicModel({n} nodes, d = {d}, input {inputs}{names})"
