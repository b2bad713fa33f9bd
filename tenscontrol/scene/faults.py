"""What breaks in a scene."""

from __future__ import annotations

from tenscontrol.scene import keys
from tenscontrol.scene.document import Document, Table
from tenscontrol.simulation import CutString, Fault, LostMeasurement, StuckWinch

_KINDS = {"cut_string": CutString, "stuck_winch": StuckWinch, "lost_measurement": LostMeasurement}


def build_faults(document: Document, strings: int, winches: int | None) -> tuple[Fault, ...]:
    """Return the faults of ``[[faults]]``.

    Parameters
    ----------
    document : Document
    strings : int
        Number of strings that can be cut: segments, where strings are cut into them.
    winches : int or None
        Number of strings that the controller commands; None where there is no controller.

    Returns
    -------
    tuple of Fault
    """
    return tuple(
        _fault(document, i, values, strings, winches)
        for i, values in enumerate(document.values.get("faults", ()))
    )


def _fault(
    document: Document, place: int, values: dict[str, object], strings: int, winches: int | None
) -> Fault:
    path, title = ("faults", place), f"[[faults]] number {place + 1}"
    kind = Table(document, path, title, values, keys.TABLES["faults"]).choice("kind", tuple(_KINDS))
    entry = Table(document, path, f"{title} with kind = {kind!r}", values, keys.FAULTS[kind])
    if kind != "cut_string" and winches is None:
        raise entry.error("kind", f"{entry.title} goes with a table [controller]")
    for key in keys.FAULTS[kind]:
        if (kind, key) != ("stuck_winch", "until"):
            entry.need(key)
    if "string" in entry:
        count = strings if kind == "cut_string" else winches
        assert count is not None  # refused above
        number = entry.need("string")
        if not 0 <= number < count:
            what = "strings" if kind == "cut_string" else "winches"
            raise entry.error(
                "string",
                f"in {entry.title}, string is {number}, expected 0 to {count - 1}: there are "
                f"{count} {what}, counted from 0",
            )
    given = {key: value for key, value in entry.values.items() if key != "kind"}
    with entry.checked():
        made: Fault = _KINDS[kind](**given)
    return made
