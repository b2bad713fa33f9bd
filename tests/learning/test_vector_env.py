"""Environments of many robots: gymnasium's own checks, episodes, rewards, seeds."""

import builtins
from typing import ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import tenscontrol as tc
from tenscontrol.learning import Reach, Rolling, Track

WINCHES = tc.Winches(rate=0.2, shortest=0.3, longest=0.9, ramp=True)


def ball():
    structure = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
    ground = tc.Ground(stiffness=5e3, damping=0.5, friction=0.5, slip_speed=0.05)
    law = tc.LinearStrings(stiffness=1000.0, damping=10.0)
    return tc.Model(structure, law, gravity=9.81, ground=ground)


def made(task=None, **changes):
    model = ball()
    settings = {
        "sample_time": 0.02, "step": 2e-3, "winches": WINCHES, "rest_length": 0.55, "count": 3,
        "nodes": tc.plant.set_down(model, [0, 4, 8]), "duration": 0.1,
    }  # fmt: skip
    return tc.vector_env(model, task or Rolling([1.0, 0.0, 0.0]), **settings | changes)


class Single(gymnasium.Env):
    """The one robot of an environment of one."""

    metadata: ClassVar = {"render_modes": ["rgb_array"], "render_fps": 50}

    def __init__(self, render_mode=None):
        self._all = made(count=1, render_mode=render_mode)
        self.render_mode = render_mode
        self.action_space = self._all.single_action_space
        self.observation_space = self._all.single_observation_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        seen, info = self._all.reset(seed=seed, options=options)
        return seen[0], info

    def step(self, action):
        seen, reward, terminated, truncated, info = self._all.step(action[None])
        return seen[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def render(self):
        return self._all.render()[0]


@pytest.mark.filterwarnings("ignore:.*box")
@pytest.mark.filterwarnings("ignore:.*Box")
@pytest.mark.filterwarnings("ignore:.*render")
def test_the_checker_of_gymnasium_passes():
    check_env(Single("rgb_array"), skip_render_check=True)


def test_spaces_episodes_and_statistics():
    env = made()
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    env = RecordEpisodeStatistics(env)
    seen, _ = env.reset(seed=0)
    assert seen in env.observation_space
    over = []
    for _ in range(12):
        action = env.action_space.sample()
        seen, reward, terminated, truncated, _ = env.step(action)
        assert seen in env.observation_space
        assert np.isfinite(reward).all()
        assert not terminated.any()
        over.append(truncated[0])
    # Five samples make an episode, and the sixth step begins the next.
    assert [k for k, is_over in enumerate(over) if is_over] == [4, 10]


def test_the_same_seed_gives_the_same_episode_and_another_one_another():
    def run(seed):
        env = made()
        first, _ = env.reset(seed=seed)
        env.action_space.seed(seed)
        return first, [env.step(env.action_space.sample())[0] for _ in range(8)]

    (a, along), (b, again), (c, _) = run(1), run(1), run(2)
    assert np.array_equal(a, b)
    assert np.array_equal(along, again)
    assert not np.array_equal(a, c)
    still, _ = made(turned=False).reset(seed=1)
    assert np.array_equal(still[0], still[1])


def test_a_turned_start_is_the_same_shape():
    env = made()
    nodes = [env.unwrapped._stepper.nodes for _ in range(2) if env.reset(seed=_)][-1]
    begin = tc.plant.set_down(ball(), [0, 4, 8])
    structure = ball().structure
    for each in nodes:
        assert np.allclose(structure.string_length(each), structure.string_length(begin))
        assert np.allclose(each[2], begin[2])
        assert np.allclose(each.mean(axis=1), begin.mean(axis=1))


def test_actions_are_parts_of_the_rate():
    env = made(duration=1.0)
    env.reset(seed=0)
    actions = np.zeros((3, 24), dtype=np.float32)
    actions[0], actions[1, 5] = -1.0, 0.5
    env.step(actions)
    wound = env.unwrapped._stepper.held - 0.55
    assert np.allclose(wound[0], -0.2 * 0.02)
    assert np.allclose(wound[1], np.where(np.arange(24) == 5, 0.5 * 0.2 * 0.02, 0.0))
    assert np.array_equal(wound[2], np.zeros(24))
    for _ in range(40):
        env.step(np.full((3, 24), 1.0, dtype=np.float32))
    assert env.unwrapped._stepper.held.max() <= 0.9


def test_rewards_of_tasks():
    env = made(turned=False)
    env.reset(seed=0)
    before = env.unwrapped._stepper.nodes
    action = np.tile(np.linspace(-1, 1, 24, dtype=np.float32), (3, 1))
    reward = env.step(action)[1]
    moved = (env.unwrapped._stepper.nodes - before).mean(axis=2)
    assert np.allclose(reward, moved[:, 0])
    place = before[0, :, 3] + [0.0, 0.0, 0.05]
    env = made(Reach(3, place), turned=False)
    seen, _ = env.reset(seed=0)
    assert np.allclose(seen[:, -3:], [0.0, 0.0, 0.05], atol=1e-6)
    reward = env.step(action)[1]
    now = np.linalg.norm(env.unwrapped._stepper.nodes[:, :, 3] - place, axis=1)
    assert np.allclose(reward, 0.05 - now, atol=1e-9)
    env = made(Reach(3, before[0, :, 3], tolerance=0.5), turned=False)
    env.reset(seed=0)
    assert env.step(action)[2].all()
    env = made(Track(3, lambda time: place + 0.1 * time[:, None]), turned=False)
    env.reset(seed=0)
    reward = env.step(action)[1]
    now = np.linalg.norm(env.unwrapped._stepper.nodes[:, :, 3] - place - 0.1 * 0.02, axis=1)
    assert np.allclose(reward, -now, atol=1e-12)


def test_a_robot_that_is_lost_ends_its_episode_and_begins_anew():
    model = tc.Model(tc.prism(), tc.LinearStrings(stiffness=1e7))
    env = tc.vector_env(
        model, Reach(0, [9.0, 0.0, 0.0]), sample_time=0.5, step=0.1, rest_length=1.0, count=2,
        winches=tc.Winches(rate=5.0, shortest=0.05, longest=9.0), duration=50.0,
    )  # fmt: skip
    env.reset(seed=0)
    ended = False
    for _ in range(20):
        seen, reward, terminated, _, info = env.step(np.array([[1.0] * 9, [-1.0] * 9]))
        assert np.isfinite(seen).all()
        assert np.isfinite(reward).all()
        ended |= "lost" in info and info["lost"].tolist() == terminated.tolist()
    assert ended


def test_the_error_of_a_step_falls_with_it():
    errors = []
    for step in (4e-3, 1e-3):
        env = made(step=step, turned=False, rest_length=0.5)
        env.reset(seed=0)
        nodes = env.unwrapped._stepper.nodes
        errors.append(env.unwrapped.step_error())
        assert np.array_equal(nodes, env.unwrapped._stepper.nodes)
    assert 0 < errors[1] < errors[0] / 16


def test_pictures():
    env = made(count=2, render_mode="rgb_array")
    env.reset(seed=0)
    frames = env.render()
    assert len(frames) == 2
    assert frames[0].dtype == np.uint8
    assert frames[0].shape == (320, 320, 3)
    assert frames[0].min() < 100 < frames[0].max()
    assert made().render() is None


def test_what_does_not_fit_is_refused(monkeypatch):
    with pytest.raises(ValueError, match="no rate or no range"):
        made(winches=tc.Winches(rate=0.1))
    with pytest.raises(TypeError, match="task"):
        made("rolling")
    with pytest.raises(ValueError, match="node is 12, expected at most 11"):
        made(Reach(12, [0.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="place has 2 entries, expected 3"):
        made(Reach(0, [0.0, 0.0]))
    with pytest.raises(ValueError, match="direction has 2 entries"):
        made(Rolling([1.0, 0.0]))
    with pytest.raises(ValueError, match="what path returns"):
        made(Track(0, lambda time: 0.0 * time))
    with pytest.raises(ValueError, match="render_mode"):
        made(render_mode="human")
    true_import = builtins.__import__

    def without(name, *rest):
        if name.startswith("gymnasium"):
            raise ModuleNotFoundError(name)
        return true_import(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    monkeypatch.delitem(__import__("sys").modules, "tenscontrol.learning.robots", raising=False)
    with pytest.raises(ImportError, match=r"tenscontrol\[learning\]"):
        made()


def test_parameters_are_drawn_for_each_episode():
    vary = {"ground.friction": tc.Uniform(0.3, 0.9), "stiffness": tc.Uniform(900.0, 1100.0)}
    env = made(vary=vary, count=24, autoreset="same_step")
    env.reset(seed=0)
    first = env.unwrapped._stepper.parameters
    assert first["stiffness"].shape == (24, 24)
    assert np.all(np.ptp(first["stiffness"], axis=1) == 0)
    assert len(np.unique(first["ground.friction"])) == 24
    for _ in range(4):
        *_, truncated, info = env.step(np.zeros(env.action_space.shape))
        assert not truncated.any()
        assert "final_obs" not in info
    seen, _, _, truncated, info = env.step(np.zeros(env.action_space.shape))
    assert truncated.all()
    assert info["_final_obs"].all()
    assert np.abs(seen - info["final_obs"]).max() > 1e-3
    assert not np.any(env.unwrapped._stepper.parameters["stiffness"] == first["stiffness"])
    again = made(vary=vary, count=24, autoreset="same_step")
    again.reset(seed=0)
    assert np.array_equal(again.unwrapped._stepper.parameters["stiffness"], first["stiffness"])
    with pytest.raises(TypeError, match=r"vary\['stiffness'\]"):
        made(vary={"stiffness": 3.0})
    with pytest.raises(ValueError, match="parameters is 'mass'"):
        made(vary={"mass": tc.Uniform(0.0, 1.0)})
    with pytest.raises(ValueError, match="autoreset"):
        made(autoreset="never")
