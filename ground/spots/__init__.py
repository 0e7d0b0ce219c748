"""Hot spots of many pictures merged into things, and fires as areas. NumPy only; no I/O.

`merging.SpotMerger` takes reports of pictures and gives `found_thing.FoundThing`s.
"""
