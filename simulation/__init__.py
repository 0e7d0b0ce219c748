"""A synthetic world with truth: flights, renderer and error study, for the demo, the tests and development."""
