"""
A ball learns to roll
=====================

A policy is trained by proximal policy optimization of Stable-Baselines3 until a six-bar ball rolls
along x. It is then put into ``simulate`` as a controller. With the libraries of
``learn_to_roll_requirements.txt``: ``python examples/learn_to_roll.py``, some minutes on one core.
"""

import argparse

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

import tenscontrol as tc

SAMPLE, STEP, EPISODE, REST_LENGTH, FACE = 0.1, 2e-3, 10.0, 0.55, [0, 4, 8]  # s, s, s, m
RATE, SHORTEST, LONGEST = 0.5, 0.4, 0.75  # m/s, m, m
WINCHES = tc.Winches(rate=RATE, shortest=SHORTEST, longest=LONGEST, ramp=True)
GOAL, TOUCHES = 2.0, 0.01  # m along x in an episode, twice as far as the ball is wide; m


def ball() -> tc.Model:
    """Return the ball on its ground."""
    structure = tc.library.six_bar_ball(bar_length=1.0, bar_mass=0.5)
    ground = tc.Ground(stiffness=5e3, damping=0.5, friction=0.7, slip_speed=0.2)
    law = tc.LinearStrings(stiffness=1000.0, damping=10.0)
    return tc.Model(structure, strings=law, gravity=9.81, ground=ground)


class Robots(VecEnv):
    """An environment of tenscontrol as Stable-Baselines3 has them."""

    def __init__(self, env):
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.env, self.render_mode = env, None

    def reset(self):
        """Return what all robots see at the start."""
        return self.env.reset(seed=self._seeds[0])[0]

    def step_async(self, actions):
        """Take note of the actions."""
        self.actions = actions

    def step_wait(self):
        """Advance by a sample; what an episode saw last is in its info."""
        seen, reward, terminated, truncated, info = self.env.step(self.actions)
        over = terminated | truncated
        infos = [{"TimeLimit.truncated": bool(cut)} for cut in truncated & ~terminated]
        for robot in np.flatnonzero(over):
            infos[robot]["terminal_observation"] = info["final_obs"][robot]
        return seen, reward.astype(np.float32), over, infos

    def close(self):
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name, indices=None):
        """Return an attribute once a robot."""
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name, value, indices=None):
        """Set an attribute."""
        setattr(self, attr_name, value)

    def env_method(self, method_name, *method_args, indices=None, **method_kwargs):
        """Call a method of the environment."""
        return [getattr(self.env, method_name)(*method_args, **method_kwargs)]

    def env_is_wrapped(self, wrapper_class, indices=None):
        """Return that nothing is wrapped."""
        return [False] * self.num_envs


class Policy:
    """A trained policy as a controller: it sees the motion and the rest lengths, as in training."""

    input, sample_time = "rest_length", SAMPLE

    def __init__(self, learner, robots):
        self.learner, self.robots, self.held = learner, robots, np.full(24, REST_LENGTH)

    def command(self, time, nodes, velocities):
        """Return the rest lengths to wind to, m."""
        beside = nodes - nodes.mean(axis=1, keepdims=True)
        seen = np.concatenate([beside.ravel(), velocities.ravel(), self.held])
        seen = self.robots.normalize_obs(seen.astype(np.float32)[None])
        action = self.learner.predict(seen, deterministic=True)[0][0].astype(float)
        wanted = self.held + np.clip(action, -1.0, 1.0) * RATE * SAMPLE
        return np.clip(wanted, SHORTEST, LONGEST)

    def applied(self, value):
        """Take note of the rest lengths that the winches reached, m."""
        self.held = np.array(value)


def main(arguments=None):
    """Train a policy, and let it roll the ball in ``simulate``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--robots", type=int, default=64)
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)

    model = ball()
    standing = tc.plant.set_down(model, FACE)
    env = tc.vector_env(
        model,
        tc.learning.Rolling([1.0, 0.0, 0.0]),
        sample_time=SAMPLE,
        step=STEP,
        method="rk4",
        winches=WINCHES,
        rest_length=REST_LENGTH,
        nodes=standing,
        count=given.robots,
        duration=EPISODE,
        turned=False,
        vary={"ground.friction": tc.Uniform(0.5, 0.9), "stiffness": tc.Uniform(950.0, 1050.0)},
        autoreset="same_step",
    )
    robots = VecNormalize(VecMonitor(Robots(env)), clip_obs=10.0, gamma=0.98)
    learner = PPO(
        "MlpPolicy",
        robots,
        n_steps=50,
        batch_size=800,
        n_epochs=5,
        gamma=0.98,
        seed=0,
        policy_kwargs={"net_arch": [128, 128], "log_std_init": -0.5},
        device="cpu",
        verbose=1,
    )
    learner.learn(given.samples)
    robots.training = False

    policy = Policy(learner, robots)
    run = tc.simulate(
        model,
        EPISODE,
        standing,
        controller=policy,
        winches=WINCHES,
        rest_length=REST_LENGTH,
        method="rk4",
        step=STEP / 2,
        output_step=SAMPLE,
    )
    way = (run.nodes[:, :, -1] - run.nodes[:, :, 0]).mean(axis=1)
    touched = int((run.nodes[2] < TOUCHES).any(axis=1).sum())
    print(
        f"in {EPISODE:g} s of simulate the ball goes {way[0]:.2f} m along x, {way[1]:.2f} m beside "
        f"it, and stands on {touched} of its 12 nodes in turn"
    )
    if way[0] < GOAL:
        print(f"less than {GOAL:g} m: train it with more --samples")


if __name__ == "__main__":
    main()
