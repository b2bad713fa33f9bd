"""The compiled core: steps of integrators and programs of controllers in C, behind ctypes."""
