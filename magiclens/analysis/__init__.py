"""What a finished lens is like, in numbers and figures."""
