"""A file's content by its form: JSON, YAML and XML without the tricks of a hostile file, or lines of text.

YAML is read by PyYAML's safe loader: OpenCV's FileStorage, which is there already, knows a part of YAML only (no list
at its key's own indent, which Kalibr writes), and what it does with damaged files happens in C++.
"""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from contract.errors import InputError
from contract.stated_values import each_once
from contract.xml_root import xml_root

MAX_BYTES = 64_000_000  # a project's cameras with all of their pictures; a calibration alone is a few kB
MAX_YAML_BYTES = 200_000  # seconds of PyYAML's
_YAML_DIRECTIVE = re.compile(r"\A%YAML[: ]1\.\d[^\n]*")
Content = dict[str, Any] | list[Any] | ET.Element | str


def content_of(path: Path) -> Content:
    """Return the mapping or list of JSON or YAML, the root of XML (tags without namespaces), else the text.

    Raises InputError for what cannot be read, and for what begins as JSON, XML or YAML and is not.
    """
    text = _text_of(path)
    if text.startswith(("{", "[")):
        return _json(text)
    if text.startswith("<"):
        return xml_root(text.encode(), "no calibration needs one")
    found = _yaml(text) if len(text) <= MAX_YAML_BYTES and _may_be_yaml(text) else None
    return found if isinstance(found, dict | list) else text


def _may_be_yaml(text: str) -> bool:
    """Return whether its first line that is no remark has a key, or is a head of YAML's."""
    lines = (line.strip() for line in text.splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    return ":" in first or first.startswith("---")


def _text_of(path: Path) -> str:
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError("a pipe or a device, and no file")  # the first may keep who opens it waiting for ever
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise InputError(f"at most {MAX_BYTES} bytes are read of a camera file, and it has more")
        return data.decode("utf-8-sig").lstrip()
    except OSError as error:
        raise InputError(str(error.strerror)) from error
    except ValueError as error:
        raise InputError(f"not a text ({error})") from error


def _json(text: str) -> Content:
    try:
        found: Content = json.loads(text, object_pairs_hook=each_once)
        return found
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON ({error})") from error


def _yaml(text: str) -> Any:
    """Return what the first document of the YAML holds: `ros2 topic echo` ends each of its messages with a ---.

    OpenCV's heads and tags are not of YAML's own.
    """
    import yaml  # noqa: PLC0415  only for those who bring one

    class Loader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML has no types
        """The safe loader, with OpenCV's one tag and without aliases: a few lines of these are gigabytes."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                mark = self.peek_event().start_mark
                raise yaml.composer.ComposerError(None, None, "an alias, which no calibration needs", mark)
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            try:
                each_once((self.construct_object(key, deep=True), None) for key, _ in getattr(node, "value", ()))
            except ValueError as error:
                raise yaml.constructor.ConstructorError(None, None, str(error), node.start_mark) from error
            found: dict[Any, Any] = super().construct_mapping(node, deep=deep)
            return found

    Loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, deep=True)
    )
    try:
        return next(yaml.load_all(_YAML_DIRECTIVE.sub("", text), Loader), None)
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f" in line {error.problem_mark.line + 1}"
        raise InputError(f"not YAML ({error.problem}{line})") from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError, OverflowError, AttributeError) as error:
        raise InputError(f"not YAML ({type(error).__name__})") from error
