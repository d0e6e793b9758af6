"""Finishing a solid: smoothing within a bound, and the checks that it must pass before it is made."""
