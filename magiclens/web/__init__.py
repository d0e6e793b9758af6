"""The gallery site and the interactive viewer."""
