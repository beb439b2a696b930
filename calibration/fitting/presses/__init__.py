"""Nominal presses: found in recordings, folders and datasets, and copied where there are few."""
