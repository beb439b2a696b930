"""What a person draws on the part of a bundle: where it judges, ignores, or is stricter."""
