"""MuJoCo: the same structure in minimal coordinates, bars as rigid bodies with quaternions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any, final

import numpy as np

from tenscontrol import validation
from tenscontrol.accuracy.peers.peer import Peer, Solution, checked_run, peer_settings, spaced
from tenscontrol.arrays import FloatArray
from tenscontrol.exchange.mjcf_export import to_mujoco
from tenscontrol.simulation.scene import Scene
from tenscontrol.structure.structure import Structure

# Method: evaluations of the forces a step, and name in MuJoCo.
_METHODS = {
    "euler": (1, "mjINT_EULER"),
    "implicit": (1, "mjINT_IMPLICIT"),
    "implicitfast": (1, "mjINT_IMPLICITFAST"),
    "rk4": (4, "mjINT_RK4"),
}

# Slack by less than this part of the rest length is round-off of a string at its border.
_SLACK = 1e-9


@final
class MuJoCo(Peer):
    """An integrator of MuJoCo with spatial tendons as strings.

    It runs what :func:`tenscontrol.exchange.to_mujoco` writes. Bars are rigid bodies in minimal
    coordinates, joined by ball joints (hinges in the plane), so that they keep their lengths
    exactly; nodes on no bar are points on slides. Joints that close a loop are springs with a time
    constant of two steps, so that its error falls with the square of the step there. The loop over
    steps runs in C between outputs. Slack/taut switches are not located: MuJoCo does not.

    Planes of :class:`~tenscontrol.Ground` are touched by nodes as small balls. MuJoCo has its own
    law there, made as alike as it can be: the stiffness is that of the ground, by a negative
    ``solref`` at the least impedance; its damping is linear, and loses what ours loses in an impact
    at 1 m/s; its friction is that of Coulomb in an elliptic cone, and viscous below it, as steep as
    ours is under a third of the weight.

    Parameters
    ----------
    method : {"euler", "implicit", "implicitfast", "rk4"}
    settings : sequence of float, optional
        Steps, s. Each is shortened so that a whole number fits between outputs.

    Raises
    ------
    ValueError
        If MuJoCo has no such method.
    """

    def __init__(
        self, method: str, settings: Sequence[float] = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5)
    ) -> None:
        self.method = validation.choice("method", method, _METHODS)
        self.name = f"mujoco {method}"
        self.settings = peer_settings(settings)

    def refuse(self, case: Scene) -> str | None:
        """See :meth:`Peer.refuse`."""
        if find_spec("mujoco") is None:
            return "mujoco is not installed: pip install 'tenscontrol[bench]'"
        try:
            _description(case, self.settings[0])
        except ValueError as error:  # it says what MuJoCo does not have
            return str(error)
        return None

    def own_law(self, case: Scene) -> str | None:
        """See :meth:`Peer.own_law`."""
        if case.model.contacts is None:
            return None
        return "contacts with linear damping, and friction that is viscous below that of Coulomb"

    def prepare(self, case: Scene, setting: float, times: FloatArray) -> Callable[[], Solution]:
        """See :meth:`Peer.prepare`."""
        setting, times = checked_run(case, setting, times)
        import mujoco

        evaluations, name = _METHODS[self.method]
        spacing, inner = spaced(times, setting)
        model = mujoco.MjModel.from_xml_string(_description(case, spacing / inner))
        model.opt.integrator = getattr(mujoco.mjtIntegrator, name)
        if not model.neq and case.model.contacts is None:
            flags = mujoco.mjtDisableBit
            model.opt.disableflags |= flags.mjDSBL_CONSTRAINT | flags.mjDSBL_CONTACT
        data, reader = mujoco.MjData(model), NodeReader(model, case.structure)

        def run() -> Solution:
            mujoco.mj_resetDataKeyframe(model, data, 0)
            read, warnings = [], list[str]()
            with _kept_warnings(mujoco, warnings):
                for _ in times:
                    mujoco.mj_step(model, data, inner)
                    read.append(reader.read(data))
            nodes, rates = reader.motion(read)
            # MuJoCo goes on with numbers that are not finite or too large.
            if warnings or not np.isfinite(rates).all():
                raise ArithmeticError(f"the state is no longer finite: {' '.join(warnings)}")
            _refuse_damped_slack(case, nodes, rates)
            return Solution(nodes, rates, evaluations=evaluations * inner * len(times))

        return run


def _description(case: Scene, step: float) -> str:
    """Return the case as MuJoCo's text."""
    held: dict[str, Any] = {case.input: case.input_value} if len(case.input_value) else {}
    return to_mujoco(
        case.model, nodes=case.nodes, velocities=case.velocities,
        external_force=case.external_force, step=step, **held,
    )  # fmt: skip


@contextmanager
def _kept_warnings(mujoco: Any, warnings: list[str]) -> Iterator[None]:
    """Collect the warnings of MuJoCo, which it would write into a file where it is run."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


class NodeReader:
    """Reads the motion of the nodes from the sites of a compiled model."""

    def __init__(self, model: Any, structure: Structure) -> None:
        import mujoco

        self._model = model
        self._updates = mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel
        self._sites = [model.site(f"n{node}").id for node in range(structure.nodes.shape[1])]
        self._bodies = model.site_bodyid[self._sites]
        self._roots = model.body_rootid[self._bodies]
        self._axes = [0, 1, 2] if structure.dimension == 3 else [0, 2]

    def read(self, data: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what :meth:`motion` needs, and leave it to the end of a run."""
        for update in self._updates:
            update(self._model, data)
        return data.site_xpos[self._sites], data.cvel[self._bodies], data.subtree_com[self._roots]

    def motion(
        self, read: Sequence[tuple[FloatArray, FloatArray, FloatArray]]
    ) -> tuple[FloatArray, FloatArray]:
        """Return nodes, m, and velocities, m/s, shape (d, n, T) each, from what was read."""
        nodes, turns, centres = (np.array(arrays) for arrays in zip(*read, strict=True))
        rates = turns[..., 3:] + np.cross(turns[..., :3], nodes - centres)
        return nodes[..., self._axes].T, rates[..., self._axes].T


def _refuse_damped_slack(case: Scene, nodes: FloatArray, velocities: FloatArray) -> None:
    """Stop where a damped string went slack: MuJoCo damps, and so pushes, all the same."""
    law, rest = case.model.strings, case.input_value
    if case.input == "force_density" or law is None or not law.is_damped:
        return
    stiffness = law.tension(2 * rest, rest) / rest  # constant: other laws were refused
    structure, damping = case.structure, law.damping
    start, end = structure.segments.T
    S, Sd = nodes[:, end] - nodes[:, start], velocities[:, end] - velocities[:, start]
    segment_length = np.sqrt((S * S).sum(axis=0))
    first = np.unique(structure.segment_string, return_index=True)[1]
    length, rate = (
        np.add.reduceat(values, first, axis=0)
        for values in (segment_length, (S * Sd).sum(axis=0) / segment_length)
    )
    stretch = length - rest[:, None]
    tension = stiffness[:, None] * stretch + damping[:, None] * rate
    room = np.minimum(stretch, tension / stiffness[:, None])
    slack = (room < -_SLACK * rest[:, None]) & (damping[:, None] > 0)
    if slack.any():
        raise ArithmeticError(
            f"string {np.argwhere(slack)[0, 0]} is damped and went slack, where MuJoCo's "
            "tendons go on damping: another law than the case's"
        )
