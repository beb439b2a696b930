"""The handshake of a station with a PLC."""
