"""Choosing one candidate per facet so that neighbours fit together (4.4)."""
