"""The daemon on the aircraft: camera and position in, georeferenced feature sets out."""
