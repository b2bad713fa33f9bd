"""What stops a sweep."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tenscontrol.robustness.report import SweepReport


class SweepError(RuntimeError):
    """A sweep that could not go on.

    A case raises it to stop the whole sweep, where not the run is at fault but
    the sweep: a parameter that it does not know, say.

    Attributes
    ----------
    report : SweepReport or None
        The runs that are done; None where it was raised by a case.
    """

    def __init__(self, message: str, report: SweepReport | None = None) -> None:
        super().__init__(message)
        self.report = report
