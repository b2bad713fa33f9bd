"""Stand-ins for the libraries that train a policy: random actions in place of learning."""

from types import ModuleType

import numpy as np


class VecEnv:
    """What an environment of Stable-Baselines3 derives from."""

    def __init__(self, num_envs, observation_space, action_space):
        self.num_envs, self._seeds = num_envs, [None] * num_envs
        self.observation_space, self.action_space = observation_space, action_space


class VecNormalize:
    """An environment whose observations are as they are."""

    def __init__(self, env, **settings):
        self.env, self.training = env, True

    def normalize_obs(self, seen):
        assert seen[0] in self.env.observation_space
        return seen


class PPO:
    """A learner that acts at random, and looks at what it is told of ends of episodes."""

    def __init__(self, policy, robots, seed, **settings):
        self.env, self.random = robots.env, np.random.default_rng(seed)

    def learn(self, samples):
        robots, count = self.env, self.env.num_envs
        robots._seeds = [0] * count
        robots.reset()
        ended = 0
        for _ in range(samples // count):
            robots.step_async(self.random.uniform(-1, 1, (count, *robots.action_space.shape)))
            seen, reward, over, infos = robots.step_wait()
            assert (len(seen), reward.shape, reward.dtype) == (count, (count,), np.float32)
            for info, is_over, begun in zip(infos, over, seen, strict=True):
                assert ("terminal_observation" in info) == is_over
                if is_over:
                    ended += 1
                    assert info["terminal_observation"] in robots.observation_space
                    assert not np.array_equal(info["terminal_observation"], begun)
        assert ended

    def predict(self, seen, deterministic):
        return self.random.uniform(-1, 1, (1, *self.env.action_space.shape)), None


def learning_libraries():
    """Return the modules by name."""
    modules = {
        "torch": {"set_num_threads": lambda count: None},
        "stable_baselines3": {"PPO": PPO},
        "stable_baselines3.common": {},
        "stable_baselines3.common.vec_env": {
            "VecEnv": VecEnv, "VecMonitor": lambda env: env, "VecNormalize": VecNormalize,
        },
    }  # fmt: skip
    made = {name: ModuleType(name) for name in modules}
    for name, contents in modules.items():
        vars(made[name]).update(contents)
    return made
