"""A clicked pixel measured by itself, in the pictures that are kept. Pure functions of arrays, and the row of pictures.

Public:

- `kept_pictures`: `KeptPictures`
- `question`: `Questions`
"""
