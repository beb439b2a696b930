"""The station in a simulated world: docs/simulation.md."""
