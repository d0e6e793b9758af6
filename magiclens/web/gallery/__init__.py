"""From a list of specs to a static site: every lens with its pictures, and the documentation."""
