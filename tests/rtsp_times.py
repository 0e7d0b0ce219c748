"""MISB ST 0604 capture times as a sender writes them into H.264 and H.265. The standard library alone."""

MISB_H264 = b"MISPmicrosectime"
MISB_H265 = bytes.fromhex("a8687dd4d7593758a5cef0338b6545f1")


def escaped(data: bytes) -> bytes:
    """With the bytes that keep start codes out of a unit."""
    out, zeros = bytearray(), 0
    for byte in data:
        if zeros >= 2 and byte <= 3:
            out.append(3)
            zeros = 0
        out.append(byte)
        zeros = zeros + 1 if byte == 0 else 0
    return bytes(out)


def sei_unit(unix_us: int, is_h265: bool) -> bytes:
    """A unit with one time: identifier, status, and the time with 0xFF after every two bytes."""
    t = unix_us.to_bytes(8, "big")
    parts = [MISB_H265 if is_h265 else MISB_H264, b"\x1f", t[:2], b"\xff", t[2:4], b"\xff", t[4:6], b"\xff", t[6:]]
    body = b"".join(parts)
    head = b"\x00\x00\x00\x01" + (b"\x4e\x01" if is_h265 else b"\x06")
    return head + escaped(bytes([5, len(body)]) + body + b"\x80")
