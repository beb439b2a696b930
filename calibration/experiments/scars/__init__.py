"""How well a station distinguishes scars of the gel from damage of the part: simulated worn gels, and the figures."""
