"""A short flight from pictures to clicked coordinates: `make demo`. It may import every package."""
