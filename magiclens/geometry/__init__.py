"""Facets, the slab under them, and the closed mesh."""
