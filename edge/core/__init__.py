"""The pure middle: frozen values, errors, ports and the arithmetic of contact, geometry, verdict and gel.

Nothing here reads a clock, a file, a socket or a log; every rule can be tested with arrays alone.
"""
