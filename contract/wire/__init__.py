"""Feature sets to bytes and back."""
