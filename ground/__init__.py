"""The light ground client: feature sets in, clicked coordinates out. NumPy and zenoh, nothing heavier at import."""
