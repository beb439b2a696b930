"""Acquisition of nominal presses, one by one, until they are enough: coverage, promise, forecast, and their folder."""
