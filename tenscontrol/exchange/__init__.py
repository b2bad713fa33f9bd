"""Structures and runs that go to and come from other programs."""

from tenscontrol.exchange.mjcf_export import to_mujoco

__all__ = ["to_mujoco"]
