"""A clicked pixel measured by itself, in the pictures that are kept. Pure functions of arrays.

Public:

- `question`: `Questions`
"""
