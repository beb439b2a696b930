"""Measure on many presses what this product promises and what it costs; an experiment is a folder on one harness."""
