"""Writes the golden picture: `python -m tests.contract.golden.make_picture`. Only with a new version of its format."""

import dataclasses
import json
from pathlib import Path

import cv2
import numpy as np

from contract.picture import ImageFormat, LinkPicture
from contract.wire.picture_code import cut
from tests.contract.pictures import START_NS


def main() -> None:
    rows, columns = np.mgrid[:36, :48]
    image = (128 + 60 * np.sin(columns / 4.0) + 50 * np.cos(rows / 3.0)).astype(np.uint8)
    content = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, 40])[1].tobytes()
    picture = LinkPicture("uav-1", 3_000_000_001, 77, START_NS, 48, 36, ImageFormat.WEBP, content)
    about = {**dataclasses.asdict(picture), "format": picture.format.value, "content": content.hex()}
    pieces = [piece.hex() for piece in cut(picture, with_parity=True, max_bytes=150)]
    text = json.dumps({"picture": about, "pieces": pieces}, indent=1) + "\n"
    (Path(__file__).parent / "picture.json").write_text(text)


if __name__ == "__main__":
    main()
