"""Sources of position, velocity and attitude events."""
