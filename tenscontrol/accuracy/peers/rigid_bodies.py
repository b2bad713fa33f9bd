"""MuJoCo: the same structure in minimal coordinates, bars as rigid bodies with quaternions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from math import ceil
from typing import Any, final

import numpy as np

from tenscontrol.accuracy.case import Case
from tenscontrol.accuracy.peer import Peer, Solution
from tenscontrol.accuracy.peers.mujoco_scene import RigidScene
from tenscontrol.dynamics import ElasticStrings, LinearStrings
from tenscontrol.validation import FloatArray, choice

# Method: evaluations of the forces a step, and name in MuJoCo.
_METHODS = {
    "euler": (1, "mjINT_EULER"),
    "implicit": (1, "mjINT_IMPLICIT"),
    "implicitfast": (1, "mjINT_IMPLICITFAST"),
    "rk4": (4, "mjINT_RK4"),
}


@final
class MuJoCo(Peer):
    """An integrator of MuJoCo with spatial tendons as strings.

    Bars are rigid bodies in minimal coordinates (six velocities, a quaternion),
    so that they keep their lengths exactly; nodes on no bar are points on three
    slides. The loop over steps runs in C between outputs. Contact and
    constraints are off. Slack/taut switches are not located: MuJoCo does not.

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
        self.settings = tuple(settings)

    def refuse(self, case: Case) -> str | None:
        """See :meth:`Peer.refuse`."""
        if find_spec("mujoco") is None:
            return "mujoco is not installed: pip install 'tenscontrol[bench]'"
        law = case.model.strings
        if case.input == "rest_length" and not isinstance(law, LinearStrings | ElasticStrings):
            return f"MuJoCo's tendons are springs of constant stiffness, not {type(law).__name__}"
        return None

    def prepare(self, case: Case, setting: float, times: FloatArray) -> Callable[[], Solution]:
        """See :meth:`Peer.prepare`."""
        import mujoco

        each, name = _METHODS[self.method]
        scene = RigidScene(case)
        model = mujoco.MjModel.from_xml_string(scene.xml)
        model.opt.integrator = getattr(mujoco.mjtIntegrator, name)
        spacing = float(times[-1]) / len(times)
        inner = max(1, ceil(spacing / setting - 1e-9))
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
