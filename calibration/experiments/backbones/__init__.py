"""The trials that backbones are compared on, and their results."""
