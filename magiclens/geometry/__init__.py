"""Facets before they are built, closed bodies, and how high bodies are above a raster."""
