"""The version, in one place for the build and for ``tenscontrol.__version__``."""

__version__ = "0.2.0"
