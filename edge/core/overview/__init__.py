"""The overview camera's rules: what a still of the part says before the press, and whether the press is admitted."""
