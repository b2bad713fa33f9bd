"""MuJoCo: the same structure in minimal coordinates, bars as rigid bodies with quaternions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any, final

import numpy as np

from tenscontrol.accuracy.case import Case
from tenscontrol.accuracy.peers.peer import Peer, Solution, checked_run, peer_settings, spaced
from tenscontrol.dynamics import ElasticStrings, LinearStrings
from tenscontrol.validation import FloatArray, choice

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

    Bars are rigid bodies in minimal coordinates (six velocities, a quaternion),
    so that they keep their lengths exactly; nodes on no bar are points on three
    slides. Bars that share nodes, carry point masses or roll, and structures in the plane are
    refused: MuJoCo's joints between bodies in a loop are springs. The loop over steps runs in C
    between outputs. Contact and constraints are off. Slack/taut switches are not located: MuJoCo
    does not.

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
        self.method = choice("method", method, _METHODS)
        self.name = f"mujoco {method}"
        self.settings = peer_settings(settings)

    def refuse(self, case: Case) -> str | None:
        """See :meth:`Peer.refuse`."""
        if find_spec("mujoco") is None:
            return "mujoco is not installed: pip install 'tenscontrol[bench]'"
        law = case.model.strings
        if case.input == "rest_length" and not isinstance(law, LinearStrings | ElasticStrings):
            return f"MuJoCo's tendons are springs of constant stiffness, not {type(law).__name__}"
        structure = case.structure
        if structure.dimension == 2:
            return "the structure is in the plane, and MuJoCo's bodies move in space"
        if structure.blocks or structure.rollers:
            found = "a roller"
            if structure.blocks:
                found = f"bar {structure.coupled_bars[0]} joined to a bar, a point mass or a roller"
            return f"bars must be apart, with both ends free or one fixed; there is {found}"
        return None

    def prepare(self, case: Case, setting: float, times: FloatArray) -> Callable[[], Solution]:
        """See :meth:`Peer.prepare`."""
        setting, times = checked_run(case, setting, times)
        import mujoco

        each, name = _METHODS[self.method]
        scene = RigidScene(case)
        model = mujoco.MjModel.from_xml_string(scene.xml)
        model.opt.integrator = getattr(mujoco.mjtIntegrator, name)
        spacing, inner = spaced(times, setting)
        model.opt.timestep = spacing / inner
        data = mujoco.MjData(model)

        def run() -> Solution:
            mujoco.mj_resetData(model, data)
            data.qvel[:] = scene.start_velocity
            data.ctrl[:], data.xfrc_applied[1:, :3] = scene.control, scene.body_force
            positions = np.empty((len(times), model.nq))
            velocities = np.empty((len(times), model.nv))
            warnings: list[str] = []
            with _kept_warnings(mujoco, warnings):
                for k in range(len(times)):
                    mujoco.mj_step(model, data, inner)
                    positions[k], velocities[k] = data.qpos, data.qvel
            # MuJoCo goes on with numbers that are not finite or too large.
            if warnings or not np.isfinite(velocities).all():
                raise ArithmeticError(f"the state is no longer finite: {' '.join(warnings)}")
            nodes, rates = scene.nodes(positions, velocities)
            scene.refuse_damped_slack(nodes, rates)
            return Solution(nodes, rates, evaluations=each * inner * len(times))

        return run


@contextmanager
def _kept_warnings(mujoco: Any, warnings: list[str]) -> Iterator[None]:
    """Collect the warnings of MuJoCo, which it would write into a file where it is run."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


class RigidScene:
    """The bodies, tendons and loads of a case; ``xml`` is MuJoCo's description.

    Every body's frame is that of space in the start. A thin bar has no inertia about its axis; it
    is given that across the axis, so that inertia is a number and spin costs no term. Constant
    loads are ``body_force`` at the centres of mass, N, shape (bodies, 3), and ``control`` on m
    single nodes, (3 m,).
    """

    def __init__(self, case: Case) -> None:
        self._case, structure = case, case.structure
        self._free = structure.bars[structure.free_bars]
        self._swinging = structure.hinged_pairs
        self._points = structure.string_nodes
        N, V = case.nodes, case.velocities
        start, end = self._free.T
        self._arm = (0.5 * (N[:, end] - N[:, start])).T
        self._reach = (N[:, self._swinging[:, 1]] - N[:, self._swinging[:, 0]]).T
        spin = _angular_velocity(self._arm, (0.5 * (V[:, end] - V[:, start])).T)
        swing = _angular_velocity(self._reach, V[:, self._swinging[:, 1]].T)
        drift = (0.5 * (V[:, start] + V[:, end])).T
        self.start_velocity = np.concatenate(
            [np.hstack([drift, spin]).ravel(), swing.ravel(), V[:, self._points].T.ravel()]
        )
        self._set_loads(case.load)
        self.xml = self._xml()

    def _set_loads(self, load: FloatArray) -> None:
        """Put loads that are equal at both ends of a bar at its centre, others node by node."""
        start, end = self._free.T
        uneven = (load[:, start] != load[:, end]).any(axis=0)
        swinging = self._swinging[:, 1]
        common = np.where(uneven, 0.0, load[:, start] + load[:, end])
        self.body_force = np.vstack(
            [common.T, np.zeros((len(swinging), 3)), load[:, self._points].T]
        )
        single = np.concatenate([self._free[uneven].ravel(), swinging])
        self._loaded = single[load[:, single].any(axis=0)]
        self.control = load[:, self._loaded].T.ravel()

    # ---- MuJoCo's description ----

    def _xml(self) -> str:
        structure, N = self._case.structure, self._case.nodes
        mass, free = structure.bar_mass, structure.free_bars
        bodies = [
            _body(0.5 * (N[:, i] + N[:, j]), "<freejoint/>", np.zeros(3), mass[bar],
                  mass[bar] * float(arm @ arm) / 3, _site(i, -arm) + _site(j, arm))  # m l²/12
            for bar, (i, j), arm in zip(free, self._free, self._arm, strict=True)
        ]  # fmt: skip
        swinging = zip(structure.swinging_bars, self._swinging, self._reach, strict=True)
        bodies += [
            _body(N[:, i], '<joint type="ball"/>', 0.5 * reach, mass[bar],
                  mass[bar] * float(reach @ reach) / 12, _site(j, reach))
            for bar, (i, j), reach in swinging
        ]  # fmt: skip
        slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in _AXES)
        bodies += [
            _body(N[:, i], slides, np.zeros(3), point_mass, point_mass, _site(i, np.zeros(3)))
            for point_mass, i in zip(structure.string_node_mass, self._points, strict=True)
        ]
        fixed = "".join(_site(i, N[:, i]) for i in structure.fixed)
        motors = "".join(
            f'<motor site="n{i}" refsite="space" gear="{axis} 0 0 0"/>'
            for i in self._loaded
            for axis in _AXES
        )
        return (
            '<mujoco><option gravity="0 0 0">'
            '<flag contact="disable" constraint="disable" autoreset="disable"/></option>'
            f'<worldbody><site name="space"/>{fixed}{"".join(bodies)}</worldbody>'
            f"<tendon>{self._tendons()}</tendon><actuator>{motors}</actuator></mujoco>"
        )

    def _tendons(self) -> str:
        structure = self._case.structure
        stiffness, rest, damping = self._springs()
        return "".join(
            f'<spatial stiffness="{stiffness[k]:.17g}" damping="{damping[k]:.17g}" '
            f'springlength="0 {rest[k]:.17g}">{_run_over(path)}</spatial>'
            for k, path in enumerate(structure.paths or structure.strings)
        )

    def _springs(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return stiffness, N/m, rest length, m, and damping, N s/m, of each string."""
        value, law = self._case.value, self._case.model.strings
        if self._case.input == "force_density":
            # T = γ l is a spring without rest length.
            return value, np.zeros_like(value), np.zeros_like(value)
        if isinstance(law, ElasticStrings):
            return law.axial_rigidity / value, value, law.damping
        assert isinstance(law, LinearStrings)  # the peer refuses other laws
        return law.stiffness, value, law.damping

    # ---- the motion, node by node ----

    def nodes(self, positions: FloatArray, velocities: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return nodes and velocities, (3, n, T), from coordinates, (T, nq) and (T, nv)."""
        structure, count = self._case.structure, len(positions)
        free, swinging = len(self._free), len(self._swinging)
        q = _split(positions, [(free, 7), (swinging, 4), (len(self._points), 3)])
        v = _split(velocities, [(free, 6), (swinging, 3), (len(self._points), 3)])
        N = np.empty((count, structure.nodes.shape[1], 3))
        V = np.zeros_like(N)
        N[:] = self._case.nodes.T  # the fixed ones stay
        arm = _turned(q[0][..., 3:], np.broadcast_to(self._arm, (count, free, 3)))
        rate = _turned(q[0][..., 3:], np.cross(v[0][..., 3:], self._arm))
        for side, sign in ((0, -1.0), (1, 1.0)):
            N[:, self._free[:, side]] = q[0][..., :3] + sign * arm
            V[:, self._free[:, side]] = v[0][..., :3] + sign * rate
        tip = self._swinging[:, 1]
        reach = _turned(q[1], np.broadcast_to(self._reach, (count, swinging, 3)))
        N[:, tip] = self._case.nodes[:, self._swinging[:, 0]].T + reach
        V[:, tip] = _turned(q[1], np.cross(v[1], self._reach))
        N[:, self._points] = self._case.nodes[:, self._points].T + q[2]
        V[:, self._points] = v[2]
        return N.transpose(2, 1, 0), V.transpose(2, 1, 0)

    def refuse_damped_slack(self, nodes: FloatArray, velocities: FloatArray) -> None:
        """Stop where a damped string went slack: MuJoCo damps, and so pushes, all the same."""
        stiffness, rest, damping = self._springs()
        if not damping.any():
            return
        structure = self._case.structure
        start, end = structure.segments.T
        S, Sd = nodes[:, end] - nodes[:, start], velocities[:, end] - velocities[:, start]
        each = np.sqrt((S * S).sum(axis=0))
        first = np.unique(structure.segment_string, return_index=True)[1]
        length, rate = (
            np.add.reduceat(part, first, axis=0) for part in (each, (S * Sd).sum(axis=0) / each)
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


_AXES = ("1 0 0", "0 1 0", "0 0 1")


def _text(vector: FloatArray) -> str:
    return " ".join(f"{x:.17g}" for x in vector)


def _run_over(path: Sequence[int]) -> str:
    """Return the nodes that a tendon runs over without friction."""
    return "".join(f'<site site="n{node}"/>' for node in path)


def _site(node: int, at: FloatArray) -> str:
    return f'<site name="n{node}" pos="{_text(at)}"/>'


def _body(
    at: FloatArray, joint: str, centre: FloatArray, mass: float, inertia: float, sites: str
) -> str:
    return (
        f'<body pos="{_text(at)}">{joint}<inertial pos="{_text(centre)}" mass="{mass:.17g}" '
        f'diaginertia="{_text(np.full(3, inertia))}"/>{sites}</body>'
    )


def _angular_velocity(arm: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the angular velocity without spin about the arm, one a row."""
    return np.asarray(np.cross(arm, rate) / (arm * arm).sum(axis=1, keepdims=True))


def _split(columns: FloatArray, blocks: list[tuple[int, int]]) -> list[FloatArray]:
    """Return consecutive blocks of coordinates, shape (T, count, width) each."""
    cuts = np.cumsum([count * width for count, width in blocks])[:-1]
    parts = np.split(columns, cuts, axis=1)
    return [part.reshape(len(columns), *block) for part, block in zip(parts, blocks, strict=True)]


def _turned(quaternions: FloatArray, vectors: FloatArray) -> FloatArray:
    """Turn vectors by unit quaternions, w first: r + 2 w (u × r) + 2 u × (u × r)."""
    w, u = quaternions[..., :1], quaternions[..., 1:]
    once = 2 * np.cross(u, vectors)
    return np.asarray(vectors + w * once + np.cross(u, once))
