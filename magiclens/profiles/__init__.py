"""Machines and materials: data files, and the models that check them."""
