"""Compiled numerics that several algorithms share."""
