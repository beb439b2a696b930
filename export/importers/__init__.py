"""Importers of trained detectors: a file of a research program becomes a bundle."""
