"""Methods to compare the others with."""
