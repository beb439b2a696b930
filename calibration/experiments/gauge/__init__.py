"""Gauge studies (measurement systems analysis): pieces x operators x repeats, and the tables that auditors expect."""
