"""The command ``tenscontrol demo``: a prism from structure to closed loop, with figures."""
