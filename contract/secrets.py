"""Texts without the secrets of addresses and commands, and files that only an owner and a group may read.

Whatever is shown, logged, sent or recorded passes through `without_secrets`: errors, the states of cameras and links,
the journal, and a configuration that is written for others than its owner.
"""

from __future__ import annotations

import os
import re
from io import BufferedWriter
from pathlib import Path
from urllib.parse import unquote

HIDDEN = "***"
_NAME = (
    r"(?:user(?:[-_]?(?:name|id|pw))?|login(?:use|pas)?|proxy[-_](?:id|pw)|pass(?:word|wd|phrase|code)?|pwd|pw|token|jwt|secret|"
    r"credentials?|auth(?:orization)?|(?:api|access|private|secret|stream)[-_]?key|key|sig(?:nature)?|session(?:[-_]?id)?)"
)
_VALUE = r"""(?:\\?"[^"]*"|'[^']*'|[^\s&;"'#,]+)"""
_HOST = r"""(?=[\w\[][\w.:\]-]*(?:[/?\s"'\\]|$))"""
_KEY = r"(?=[\w-]*\d)(?=[\w-]*[A-Za-z])"  # letters and digits, as keys have them
_PLAIN_STREAM = r"(?!(?:cam|ch|stream|video|main|sub|track|profile)[a-z]*[-_]?\d*(?:[-_][a-z]+)?\b)"
_RULES = (
    # User and password before a host. A password may have what an address must not: a slash, a second @. Digits and a
    # slash after the first colon are a port.
    (re.compile(r"""(?<=//)(?:[^\s/@:"']*:(?!\d+(?:[/?]|$))[^\s"']*@|[^/@\s"']*@)"""), ""),
    # A password of digits with a slash, where what comes then is a host; one with blanks or quotes.
    (re.compile(r"""(?<=//)[^\s/@:"']+:\d+/[^\s"'@]*@(?=[^\s/@"']*(?:/|\.\w|:\d))"""), ""),
    (re.compile(rf"""(?<=//)[^\s/@:"']+:(?!\d+(?:[/?:\s"',;)]|$))\S(?:(?!://)[^\n@]){{0,80}}@{_HOST}"""), ""),
    # The same in an address whose // was forgotten, and of curl's -u.
    (re.compile(r"""(?<!\w)((?:rtsp[tus]?|https?|srt|rtmps?|ftp|udp|tcp):/?)(?!/)[^\s/@"']+@"""), r"\1"),
    (re.compile(r"""(\s-u\s*)(?![\w-]+://)[^\s:]+:\S+"""), rf"\1{HIDDEN}"),
    # ?token=..., user-pw=... of a pipeline, PASSWORD=... before a command. Not a key of ours: link.key.
    (re.compile(rf"(?<![\w.])((?:[A-Za-z0-9]+[-_])*{_NAME}\s*=\s*){_VALUE}", re.IGNORECASE), rf"\1{HIDDEN}"),
    # Stream keys: SRT's, the last part of RTMP's path, and of others what looks like one behind live/.
    (re.compile(r"""(\bstream-?_?(?:id|name)\s*=\s*)(?:"[^"]*"|[^\s&"']+)""", re.IGNORECASE), rf"\1{HIDDEN}"),
    (re.compile(r"""(\brtmp[a-z]*://[^\s/"']+/[^\s"'?]+/)[^\s/"'?]+""", re.IGNORECASE), rf"\1{HIDDEN}"),
    (re.compile(rf"(://\S*?/(?:live|app|play|publish|ingest)/){_KEY}{_PLAIN_STREAM}[\w-]{{8,}}", re.I), rf"\1{HIDDEN}"),
    (re.compile(rf"((?:rtsp[tus]?|srt|udp)://\S*?/){_KEY}[\w-]{{20,}}(?![\w.])", re.I), rf"\1{HIDDEN}"),
    (re.compile(r"(\bx-(?:[a-z]+-)*(?:key|token)\s*:\s*)[^\s\"']+", re.IGNORECASE), rf"\1{HIDDEN}"),
    (re.compile(r"(authorization\s*[:=]\s*)(?:(?:basic|bearer|digest)\s+)?[^\s\"']+", re.IGNORECASE), rf"\1{HIDDEN}"),
)
# Only of another's program: "--key with --certificate" is a sentence of ours.
_ARGUMENT = re.compile(rf"(?<!\S)(--?(?:[A-Za-z0-9]+[-_])*{_NAME}\s+){_VALUE}", re.IGNORECASE)


_ENCODED = re.compile(r"""[^\s"']*%[0-9A-Fa-f]{2}[^\s"']*""")


def _decoded(found: re.Match[str]) -> str:
    """Return percent-encoded text without its secrets if it has any, and then no longer encoded."""
    plain = unquote(unquote(found[0]))
    cleaned = without_secrets(plain) if "%" not in plain else plain
    return found[0] if cleaned == plain else cleaned


def without_secrets(text: str) -> str:
    """The text without users and passwords of addresses, and without values of what is named as a secret."""
    text = _ENCODED.sub(_decoded, text)
    for pattern, instead in _RULES:
        text = pattern.sub(instead, text)
    return _ARGUMENT.sub(rf"\1{HIDDEN}", text) if "exec:" in text else text


def new_recording(path: Path, *, is_new: bool = True) -> BufferedWriter:
    """A file to write that its owner may read and write, its group read, and all others neither. Raises OSError, with
    `is_new` also where there is one.
    """
    return os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | (os.O_EXCL if is_new else os.O_TRUNC), 0o640), "wb")
