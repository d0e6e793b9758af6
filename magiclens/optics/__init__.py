"""Geometrical optics of the slab: Snell, Fresnel, orientation, rays. Pure functions, compiled with numba."""
