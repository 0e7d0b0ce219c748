"""The reasons for which a clicked pixel was not measured by itself, for people."""

from __future__ import annotations

from contract.feature_set import Measured

NOT_TRIED = "the aircraft did not try"  # older software, tracks.enabled = false, or too much was asked at once
NO_ANSWER = "the aircraft did not answer in time"
TOO_MANY = "too many clicks were being measured"
MOST_CHARACTERS = 200

_SENTENCES = {
    Measured.NO_PICTURE: "the aircraft holds this picture no longer",
    Measured.BORDER: "too close to the picture's edge",
    Measured.FEW_VIEWS: "fewer than three other pictures show the place from elsewhere",
    Measured.NO_TEXTURE: "nothing there to recognise in other pictures",
    Measured.REPEATED: "it looks the same at two depths, as rows and tiles do",
    Measured.HIDDEN: "something else is in the way in most other pictures",
    Measured.EDGE: "two surfaces meet there, and which of them was clicked is not clear",
    Measured.MOVES: "its depth is one that no ground has: it moves",
    Measured.ROLLING: "the camera reads its rows one after the other",
}


def in_words(unmeasured: str) -> str:
    """A sentence for the word that an answer states; what is no such word stays as it is."""
    return next((text for word, text in _SENTENCES.items() if word.value == unmeasured), unmeasured)
