"""`gelgate evaluate`: a bundle scored on a dataset: metrics, a JSON report and a sheet of pictures."""
