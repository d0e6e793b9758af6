"""Results of earlier runs, kept by what they were made of."""
