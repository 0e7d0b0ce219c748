"""Sources of Frames."""
