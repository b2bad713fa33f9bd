"""MuJoCo: the same structure in minimal coordinates, bars as rigid bodies with quaternions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any, final

import casadi as ca
import numpy as np

from tenscontrol.accuracy.case import Case
from tenscontrol.accuracy.peers.peer import Peer, Solution, checked_run, peer_settings, spaced
from tenscontrol.dynamics import ElasticStrings, Ground, LinearStrings
from tenscontrol.validation import FloatArray, choice

# Method: evaluations of the forces a step, and name in MuJoCo.
_METHODS = {
    "euler": (1, "mjINT_EULER"),
    "implicit": (1, "mjINT_IMPLICIT"),
    "implicitfast": (1, "mjINT_IMPLICITFAST"),
    "rk4": (4, "mjINT_RK4"),
}

# MuJoCo's contacts are springs and dashpots where their impedance is its least: its default takes
# most of what other forces do from the bodies in contact, too.
_IMPEDANCE = 1e-4

# The speed of an impact, m/s, in which its linear damping takes what that of our law takes.
_IMPACT = 1.0

# Radius of the balls at nodes that touch, as part of the size.
_BALL = 1e-4

# Bits by which it tells which balls touch which plane.
_MOST_PLANES = 31

# Slack by less than this part of the rest length is round-off of a string at its border.
_SLACK = 1e-9


@final
class MuJoCo(Peer):
    """An integrator of MuJoCo with spatial tendons as strings.

    Bars are rigid bodies in minimal coordinates (six velocities, a quaternion),
    so that they keep their lengths exactly; nodes on no bar are points on three
    slides. Bars that share nodes, carry point masses or roll, and structures in the plane are
    refused: MuJoCo's joints between bodies in a loop are springs. The loop over steps runs in C
    between outputs. Slack/taut switches are not located: MuJoCo does not.

    Constraints are off, but for planes of :class:`~tenscontrol.Ground`, which nodes touch as small
    balls. MuJoCo has its own law there, made as alike as it can be: the stiffness is that of the
    ground, by a negative ``solref`` at the least impedance; its damping is linear, and loses what
    ours loses in an impact at 1 m/s; its friction is that of Coulomb in an elliptic cone, and
    viscous below it, as steep as ours is under a third of the weight.

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
        if len(case.model.ground) > _MOST_PLANES:
            return f"MuJoCo tells at most {_MOST_PLANES} planes with nodes of their own apart"
        for ground in case.model.ground:
            if not isinstance(ground, Ground) or isinstance(ground.height, ca.Function):
                return f"MuJoCo's contacts are springs on planes, not {ground!r:.60}"
            if ground.friction and not ground.damping:
                return "MuJoCo's contacts rub by their damping, and the ground has none"
        return None

    def own_law(self, case: Case) -> str | None:
        """See :meth:`Peer.own_law`."""
        if case.model.contacts is None:
            return None
        return "contacts with linear damping, and friction that is viscous below that of Coulomb"

    def prepare(self, case: Case, setting: float, times: FloatArray) -> Callable[[], Solution]:
        """See :meth:`Peer.prepare`."""
        setting, times = checked_run(case, setting, times)
        import mujoco

        each, name = _METHODS[self.method]
        scene = RigidScene(case)
        model = mujoco.MjModel.from_xml_string(scene.xml)
        scene.set_contacts(model)
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
        self._laws = list(case.model.contacts or ())
        self._radius = _BALL * case.size
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
        bodies = [  # inertia m l²/12
            _body(0.5 * (N[:, i] + N[:, j]), "<freejoint/>", np.zeros(3), mass[bar],
                  mass[bar] * float(arm @ arm) / 3, self._node(i, -arm) + self._node(j, arm))
            for bar, (i, j), arm in zip(free, self._free, self._arm, strict=True)
        ]  # fmt: skip
        swinging = zip(structure.swinging_bars, self._swinging, self._reach, strict=True)
        bodies += [
            _body(N[:, i], '<joint type="ball"/>', 0.5 * reach, mass[bar],
                  mass[bar] * float(reach @ reach) / 12, self._node(j, reach))
            for bar, (i, j), reach in swinging
        ]  # fmt: skip
        slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in _AXES)
        bodies += [
            _body(N[:, i], slides, np.zeros(3), point_mass, point_mass, self._node(i, np.zeros(3)))
            for point_mass, i in zip(structure.string_node_mass, self._points, strict=True)
        ]
        fixed = "".join(_site(i, N[:, i]) for i in structure.fixed)
        motors = "".join(
            f'<motor site="n{i}" refsite="space" gear="{axis} 0 0 0"/>'
            for i in self._loaded
            for axis in _AXES
        )
        touch = "enable" if self._laws else "disable"
        return (
            '<mujoco><option gravity="0 0 0" cone="elliptic" tolerance="1e-14">'
            f'<flag contact="{touch}" constraint="{touch}" autoreset="disable"/></option>'
            f'<worldbody><site name="space"/>{self._planes()}{fixed}{"".join(bodies)}</worldbody>'
            f"<tendon>{self._tendons()}</tendon><actuator>{motors}</actuator></mujoco>"
        )

    def _planes(self) -> str:
        """Return a plane for each law, lower by the radius of the balls."""
        found = []
        for i, (law, _, _) in enumerate(self._laws):
            up = law.up(3)
            at = f'pos="{_text((law.height - self._radius) * up)}" zaxis="{_text(up)}"'
            bits = f'contype="{1 << i}" conaffinity="0"'
            found.append(f'<geom type="plane" size="1 1 1" {at} {bits}/>')
        return "".join(found)

    def _node(self, node: int, at: FloatArray) -> str:
        """Return the site of a node, with a ball for each law that acts on it."""
        balls = "".join(
            f'<geom name="ball{node}_{i}" size="{self._radius:.17g}" pos="{_text(at)}" mass="0" '
            f'contype="0" conaffinity="{1 << i}" priority="1" condim="3" '
            f'friction="{law.friction:.17g} 0 0"/>'
            for i, (law, nodes, _) in enumerate(self._laws)
            if node in nodes
        )
        return _site(node, at) + balls

    def set_contacts(self, model: Any) -> None:
        """Give MuJoCo's contacts the stiffness of the ground and the damping nearest to its own.

        MuJoCo's parameters are accelerations, by the inverse mass of the body.
        """
        weight = float(np.linalg.norm(self._case.load.sum(axis=1))) / 3
        steepest = 1.0
        for i, (law, nodes, _) in enumerate(self._laws):
            for node in nodes:
                ball = model.geom(f"ball{node}_{i}").id
                inverse = float(model.body_invweight0[model.geom_bodyid[ball], 0])
                depth = _IMPACT / np.sqrt(4 * law.stiffness * inverse)  # of a bar's end, about
                damping = 4 / (3 * np.pi) * law.stiffness * law.damping * depth
                model.geom_solref[ball] = -law.stiffness * inverse, -damping * inverse
                model.geom_solimp[ball, :2] = _IMPEDANCE
                if damping:
                    rubs = law.friction * weight / (law.slip_speed * damping)
                    steepest = max(steepest, rubs)
        model.opt.impratio = steepest

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
