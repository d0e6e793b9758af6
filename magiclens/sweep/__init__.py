"""Sweeps: one spec, run with every combination of some values, and a sheet to compare them."""
