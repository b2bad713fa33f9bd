"""The compiled core in C, called through ctypes."""
