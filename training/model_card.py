"""The page that goes with the net: data, licence, training, figures and limits, from what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Stated = Mapping[str, Any]

CITED = (
    "HIT-UAV (Suo et al., *HIT-UAV: A high-altitude infrared thermal dataset for Unmanned Aerial Vehicle-based object"
    " detection*, Scientific Data 10, 227 (2023), https://github.com/suojiashun/HIT-UAV-Infrared-Thermal-Dataset),"
    " licence CC BY 4.0 (https://creativecommons.org/licenses/by/4.0/)"
)
SETS = {
    "all": "as they are", "night": "night", "day": "day", "black_hot": "black hot",
    "half_size": "half the size (320 x 256)",
}  # fmt: skip
PER_KM2 = ("1", "10", "100", "300")


def row(*cells: object) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def head(*cells: str) -> list[str]:
    return [row(*cells), f"|{'---|' * len(cells)}"]


def figures_table(test: Stated) -> list[str]:
    """Return the rows of average precision and recall, for each kind and set of pictures that has any."""
    lines = head(
        "kind", "pictures", "labelled", "average precision", *(f"recall at {per} false/km2" for per in PER_KM2)
    )
    for kind in test["all"]:
        for name, words in SETS.items():
            of = test[name][kind]
            if of["things"]:
                at = of["recall_and_threshold_at_false_per_km2"]
                recall = (f"{at[per][0]:.2f} (from {at[per][1]:.2f})" for per in PER_KM2)
                lines.append(row(kind, words, of["things"], f"{of['average_precision']:.3f}", *recall))
    return lines


def reliability_table(stated: Stated) -> list[str]:
    """Return the rows of log ratios, for each kind, and for people in pictures of half the size."""
    lines = head("kind", "score", "at things", "false", "log ratio stated", "log ratio there")
    parts = {**stated["reliability"], "person, half the size": stated["reliability_half_size"]["person"]}
    for kind, rows in parts.items():
        for of in rows:
            span = f"{of['from_score']:.2f} to {of['to_score']:.2f}"
            lines.append(row(kind, span, of["true"], of["false"], f"{of['stated']:.1f}", f"{of['measured']:.1f}"))
    return lines


def again_table(kinds: Stated) -> list[str]:
    lines = head("kind", "false places: shared, lost (looks)", "things: shared, lost (looks)")
    for kind, of in kinds.items():
        cells = (
            f"{of[f'{name}_again']['shared']:.2f}, {of[f'{name}_again']['lost']:.2f} ({of[f'{name}_again_places']})"
            for name in ("false", "found")
        )
        lines.append(row(kind, *cells))
    return lines


def card(stated: Stated) -> str:
    """Return the model card, as Markdown, of what `thermal_things.json` states."""
    test = stated["test"]
    return "\n".join(
        [
            "# Model card: thermal_things.onnx",
            "",
            "Written by `python -m training.thermal_things`; the figures are those of `thermal_things.json`.",
            "",
            f"A convolutional net ({stated['bytes'] / 1e6:.1f} MB) that finds people, vehicles and other things"
            " (bicycles) in single thermal pictures. ONNX opset 17, read by OpenCV's dnn:"
            f" {test['milliseconds_640x512']:.0f} ms a look of 640 x 512 and {test['milliseconds_320x256']:.0f} ms of"
            " 320 x 256, one thread of the machine that judged it. Input and output: `training/net_input.py`,"
            " `training/peaks.py`.",
            "",
            f"**Data:** {CITED}. The weights are made from these pictures; no picture of them is in this package."
            " Whoever passes the weights on names the data and this licence.",
            "",
            f"**Training:** {stated['training']}",
            "",
            "## Figures",
            "",
            f"One look each at the {test['pictures']} pictures of two flights (numbers 281 to 726 and 8067 to 9883) of"
            " which training has seen none. Ground areas are from an assumed focal length of 2,000 px;"
            " false ones include what the labels lack.",
            "",
            *figures_table(test),
            "",
            "## Calibration",
            "",
            f"`thermal_things.json` states for each kind how the scores of things and of false peaks fall, from all"
            f" {stated['calibration_pictures'] + stated['calibration_test_pictures']} pictures that were not trained"
            f" on. How far that holds elsewhere: the log likelihood ratio (things in a megapixel, over false peaks)"
            f" by {stated['calibration_pictures']} of them, against that of the {stated['calibration_test_pictures']}"
            " others, of other ground:",
            "",
            *reliability_table(stated),
            "",
            "Looks at one place are not independent. Fitted to"
            f" {stated['pairs']['moved']['pairs']} pairs of those pictures between which the camera moved"
            " (`training/again.py`):",
            "",
            *again_table(stated["kinds"]),
            "",
            "## Limits",
            "",
            "- One camera (DJI, 640 x 512, 8 bits, its own gain), 60 to 130 m up, 30 to 90 degrees down, over roads,"
            " yards, fields and car parks of one country. Of other cameras, seasons, heights and ground nothing is"
            " measured.",
            "- By day people hardly differ from their ground: see the row. That is the camera, not the net; do not"
            " conclude from an empty day that no one is there.",
            "- People lying, in water, below leaves or behind windows are not among the labels as such.",
            "- Smaller than about 8 px a thing is often missed: `by_size` and `by_size_half` in the file.",
            "- It does not identify anyone, and is not for that.",
            "",
        ]
    )
