"""Hot spots in a thermal camera's pictures: what stands out of its ground, where it is, and how sure. Section 25.

Public:

- `due_pictures`: `DuePictures`
- `looking`: `Look`, `looking`
- `spot_book`: `SpotBook`
"""
