"""A month on a simulated line: one part, two stations, a person who answers some questions a day; what went wrong."""
