"""The lens as a machine makes it, and what it shows then."""
