"""Overview cameras: they see the part before the press. `recorded` of plugins.devices serves as one too."""
