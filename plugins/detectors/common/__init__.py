"""The mathematics that several detectors share, each written once: smoothing, distances, low rank."""
