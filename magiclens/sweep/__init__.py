"""Runs a spec with many combinations of values, and compares the lenses on one sheet."""
