"""What a machine and a finish make of a surface: maps from heights to heights, which know nothing of lenses."""
