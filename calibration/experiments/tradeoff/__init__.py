"""What accuracy costs: many operating points on one dataset, measured in one run; see docs/studies.md."""
