"""The pictures themselves: functions without arguments that return layers, bottom first, in picture units."""
