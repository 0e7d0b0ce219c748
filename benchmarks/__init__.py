"""Measurements: claims of speed and accuracy, each printed by one command. Not part of the installed package."""
