"""The digital inputs and outputs of a station: one owner thread per device."""
