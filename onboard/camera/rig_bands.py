"""Rigs of several cameras that expose together (multispectral, or wide, zoom and thermal): one is a flight's camera."""

from __future__ import annotations

from collections import Counter

from onboard.camera.photo_metadata import PhotoMetadata


def one_band(photos: list[PhotoMetadata]) -> tuple[list[PhotoMetadata], str]:
    """The photographs of one camera of a rig, and how that was chosen; all of them and "" where there is no rig.

    The others stand elsewhere and look elsewhere by some tenths of a degree, each with its own lens. Of the bands the
    one with most photographs is taken, among equals the first.
    """
    bands = Counter(photo.band for photo in photos)
    if None in bands or len(bands) < 2:
        return photos, ""
    known = [band for band in bands if band is not None]
    chosen = min(known, key=lambda band: (-bands[band], band))
    name = f"{chosen[1]}, " if chosen[1] else ""
    kept = [photo for photo in photos if photo.band == chosen]
    return kept, f"{name}camera {chosen[0]} of a rig of {len(known)}; the others' {len(photos) - len(kept)} left out"
