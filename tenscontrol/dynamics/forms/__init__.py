"""Forms of the state equation for large scenes."""

from tenscontrol.dynamics.forms.elimination import members_alone
from tenscontrol.dynamics.forms.loops import (
    C_EXPORT,
    C_HEAD,
    external_interface,
    loops_functions,
    loops_source,
)
from tenscontrol.dynamics.forms.mapped import mapped_functions
from tenscontrol.dynamics.forms.packed_code import PACKED_HEAD, packed_source

__all__ = [
    "C_EXPORT",
    "C_HEAD",
    "PACKED_HEAD",
    "external_interface",
    "loops_functions",
    "loops_source",
    "mapped_functions",
    "members_alone",
    "packed_source",
]
