"""A reader of TAK data packages, by the format's public description: what a receiver makes of one."""

import io
import xml.etree.ElementTree as ET
import zipfile
from pathlib import PurePosixPath

from PIL import Image

SHOWN = {"JPEG", "PNG"}  # by every TAK


class Package:
    """Its events by uid, and the pictures attached to each. Fails where a receiver would leave something out."""

    def __init__(self, content: bytes) -> None:
        self.events: dict[str, ET.Element] = {}
        self.pictures: dict[str, list[Image.Image]] = {}
        with zipfile.ZipFile(io.BytesIO(content)) as package:
            assert package.testzip() is None
            root = ET.fromstring(package.read("MANIFEST/manifest.xml"))
            assert (root.tag, root.get("version")) == ("MissionPackageManifest", "2")
            about = root.find("Configuration")
            assert about is not None
            self.about = parameters(about)
            assert self.about["uid"] and self.about["name"]
            listed = list(root.iterfind("Contents/Content"))
            entries = [item.get("zipEntry", "") for item in listed]
            assert sorted([*entries, "MANIFEST/manifest.xml"]) == sorted(package.namelist())
            attached = []
            for item, entry in zip(listed, entries, strict=True):
                path = PurePosixPath(entry)
                assert item.get("ignore") == "false" and not path.is_absolute() and ".." not in path.parts
                uid, data = parameters(item)["uid"], package.read(entry)
                if path.suffix == ".cot":
                    event = ET.fromstring(data)
                    assert event.tag == "event" and event.get("uid") == uid and uid not in self.events
                    self.events[uid] = event
                    self.pictures[uid] = []
                else:
                    attached.append((uid, Image.open(io.BytesIO(data))))
        for uid, picture in attached:
            assert picture.format in SHOWN
            self.pictures[uid].append(picture)  # a KeyError: attached to nothing


def parameters(parent: ET.Element) -> dict[str, str]:
    return {p.get("name", ""): p.get("value", "") for p in parent.iterfind("Parameter")}
