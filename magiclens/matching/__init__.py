"""Facet-patch matching (4.2): which patch of the source should each facet show?"""
