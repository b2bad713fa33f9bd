"""Stiff and extreme structures: every method on every one, none silently wrong."""

from tenscontrol.accuracy.suite.result import SuiteResult
from tenscontrol.accuracy.suite.runner import extreme_suite, main
from tenscontrol.accuracy.suite.verdict import Verdict

__all__ = ["SuiteResult", "Verdict", "extreme_suite", "main"]
