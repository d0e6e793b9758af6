"""A small part that shows, in one photograph, what a printer, its finish and its material make of a lens."""
