"""`gelgate evaluate`: a bundle scored on a dataset; exact measures, a JSON report and a sheet of pictures."""
