"""Reads YAML specs: their keys, units and errors with line numbers. Scenario and stages stay plain mappings here."""
