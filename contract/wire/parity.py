"""Content cut into pieces of one packet each, with parities from which one lost piece of each group comes back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

GROUP = 6  # pieces for each parity


def groups_of(pieces: int) -> int:
    """Groups of so many pieces; a single one needs no parity: it may as well be sent again."""
    return -(-pieces // GROUP) if pieces > 1 else 0


def share_of(size: int, pieces: int) -> int:
    """Bytes of a piece of content of `size` bytes; the last may have fewer."""
    return -(-size // pieces)


def length_of(size: int, pieces: int, number: int) -> int:
    """Bytes of piece `number`; from `pieces` on they are parities."""
    share = share_of(size, pieces)
    return share if number >= pieces else max(min(share, size - number * share), 0)


def pieces_of(content: bytes, pieces: int) -> list[bytes]:
    """The content in so many pieces."""
    share = share_of(len(content), pieces)
    return [content[i * share : (i + 1) * share] for i in range(pieces)]


def parities(contents: Sequence[bytes]) -> list[bytes]:
    """The parities of all pieces, in order: parity g is that of the pieces i with i modulo the number of groups = g."""
    groups = groups_of(len(contents))
    return [_parity(contents[g::groups], len(contents[0])) for g in range(groups)]


def joined(size: int, pieces: int, came: Mapping[int, bytes]) -> bytes | None:
    """The content of the pieces that came, by number; None while too many are missing."""
    contents, groups = dict(came), groups_of(pieces)
    for group in range(groups):
        members = range(group, pieces, groups)
        missing = [i for i in members if i not in contents]
        parity = contents.get(pieces + group)
        if len(missing) == 1 and parity is not None:
            known = [contents[i] for i in members if i in contents]
            contents[missing[0]] = _parity([*known, parity], len(parity))[: length_of(size, pieces, missing[0])]
    if any(i not in contents for i in range(pieces)):
        return None
    return b"".join(contents[i] for i in range(pieces))


def _parity(contents: Sequence[bytes], share: int) -> bytes:
    """The exclusive or of contents, shorter ones with zeros behind."""
    total = 0
    for content in contents:
        total ^= int.from_bytes(content.ljust(share, b"\0"), "little")
    return total.to_bytes(share, "little")
