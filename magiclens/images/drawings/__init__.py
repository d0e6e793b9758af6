"""The drawings: functions that return layers, the lowest first, in picture units."""
