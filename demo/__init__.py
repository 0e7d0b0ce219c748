"""A short flight from pictures to clicked coordinates: `make demo`. Above the house: it may use every room."""
