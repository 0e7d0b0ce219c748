"""Shared libraries (ELF, 64 bit, little-endian) made smaller without a compiler: what only debuggers read goes, and
libraries that are never called are no longer asked for.

Works on another architecture's files as on this one's: nothing is run, only tables are rewritten. Names are those of
elf(5).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

MACHINES = {"amd64": 62, "arm64": 183}  # EM_X86_64, EM_AARCH64
PT_LOAD, PT_DYNAMIC = 1, 2
DT_NULL, DT_NEEDED, DT_STRTAB, DT_SYMTAB = 0, 1, 5, 6
DT_VERSYM, DT_VERNEED, DT_VERNEEDNUM = 0x6FFFFFF0, 0x6FFFFFFE, 0x6FFFFFFF
SYMBOL = struct.Struct("<IBBHQQ")
STB_WEAK, SHN_UNDEF, VER_NDX_GLOBAL, SHT_DYNSYM = 2, 0, 1, 11


class ElfError(ValueError):
    """The file is not as it must be to be rewritten; the message says what is wrong."""


@dataclass
class Segment:
    """A program header."""

    kind: int
    flags: int
    offset: int
    address: int
    physical: int
    in_file: int
    in_memory: int
    align: int

    FORMAT = struct.Struct("<IIQQQQQQ")


def is_elf(raw: bytes) -> bool:
    """Whether this is an ELF file that we read: 64 bit, little-endian."""
    return raw[:6] == b"\x7fELF\x02\x01"


def machine(raw: bytes) -> int:
    """The processor that the file is for, as in `MACHINES`."""
    return int(struct.unpack_from("<H", raw, 18)[0])


def segments(raw: bytes) -> list[Segment]:
    """The program headers."""
    (at,) = struct.unpack_from("<Q", raw, 32)
    size, count = struct.unpack_from("<HH", raw, 54)
    return [Segment(*Segment.FORMAT.unpack_from(raw, at + i * size)) for i in range(count)]


def without_debugging(raw: bytes) -> bytes:
    """The file with what is loaded and nothing else: symbols and sections that only linkers and debuggers read go.

    Addresses stay; segments move up in the file, by whole multiples of their alignment. Raises ElfError if a header
    points at something that is not loaded.
    """
    headers = segments(raw)
    loads = sorted((s for s in headers if s.kind == PT_LOAD), key=lambda s: s.offset)
    (table_at,) = struct.unpack_from("<Q", raw, 32)
    table_end = table_at + len(headers) * Segment.FORMAT.size
    out = bytearray(raw[:64])
    if not loads or loads[0].offset > 0 or not any(s.offset <= table_at and table_end <= _end(s) for s in loads):
        raise ElfError("its headers are not loaded")
    moved: list[tuple[Segment, int]] = []
    for load in loads:
        align = max(load.align, 1)
        at = len(out) + (load.offset - len(out)) % align if load.offset else 0
        out[len(out) :] = bytes(max(at - len(out), 0))
        out[at:] = raw[load.offset : _end(load)]
        moved.append((load, at))

    def new_place(offset: int, size: int) -> int:
        for load, at in moved:
            if load.offset <= offset and offset + size <= _end(load):
                return at + offset - load.offset
        raise ElfError(f"{size} bytes at {offset} are not loaded")

    new_table = new_place(table_at, table_end - table_at)
    struct.pack_into("<QQ", out, 32, new_table, 0)  # no section headers
    struct.pack_into("<HHH", out, 58, 64, 0, 0)
    for index, header in enumerate(headers):
        if header.kind == PT_LOAD:
            offset = next(at for load, at in moved if load is header)
        elif header.in_file:
            offset = new_place(header.offset, header.in_file)
        else:
            offset = 0
        new = Segment(**{**vars(header), "offset": offset})
        Segment.FORMAT.pack_into(out, new_table + index * Segment.FORMAT.size, *vars(new).values())
    return bytes(out)


def _end(segment: Segment) -> int:
    return segment.offset + segment.in_file


class Dynamic:
    """What a shared library asks the loader for; `raw` is the file, rewritten in place."""

    def __init__(self, raw: bytes) -> None:
        """Raises ElfError if it has no dynamic section."""
        self.raw = bytearray(raw)
        self._loads = [s for s in segments(raw) if s.kind == PT_LOAD]
        found = [s for s in segments(raw) if s.kind == PT_DYNAMIC]
        if not found:
            raise ElfError("not a shared library")
        self._at = found[0].offset
        self.entries: list[tuple[int, int]] = []
        while not self.entries or self.entries[-1][0] != DT_NULL:
            self.entries.append(struct.unpack_from("<QQ", raw, self._at + 16 * len(self.entries)))

    def _offset(self, address: int) -> int:
        for load in self._loads:
            if load.address <= address < load.address + load.in_file:
                return load.offset + address - load.address
        raise ElfError(f"address {address:#x} is in no segment")

    def _value(self, tag: int) -> int | None:
        return next((value for t, value in self.entries if t == tag), None)

    def _table(self, tag: int) -> int:
        value = self._value(tag)
        if value is None:
            raise ElfError(f"no table {tag:#x}")
        return self._offset(value)

    def _string(self, offset: int) -> str:
        begin = self._table(DT_STRTAB) + offset
        return self.raw[begin : self.raw.index(0, begin)].decode()

    @property
    def needed(self) -> list[str]:
        """Libraries that are loaded with it."""
        return [self._string(value) for tag, value in self.entries if tag == DT_NEEDED]

    def symbols(self) -> Iterator[tuple[int, str, bool]]:
        """Index, name and whether it is defined here, of every dynamic symbol.

        How many there are stands in the section headers alone. Raises ElfError once those have gone.
        """
        (sections_at,) = struct.unpack_from("<Q", self.raw, 40)
        size, count = struct.unpack_from("<HH", self.raw, 58)
        headers = (struct.unpack_from("<IIQQQQ", self.raw, sections_at + i * size) for i in range(count))
        table = next((h for h in headers if h[1] == SHT_DYNSYM), None)
        if table is None:
            raise ElfError("no section headers")
        for index in range(1, table[5] // SYMBOL.size):
            name, _, _, section, _, _ = SYMBOL.unpack_from(self.raw, table[4] + index * SYMBOL.size)
            yield index, self._string(name), section != SHN_UNDEF

    def forget(self, libraries: set[str], names: set[str]) -> None:
        """Ask no longer for `libraries` (as in `needed`), whose exported symbols are `names`: those become null.

        Who calls one all the same ends by a segmentation fault; the caller has to see to it that nobody does.
        """
        begin, has_versions = self._table(DT_SYMTAB), self._value(DT_VERSYM) is not None
        gone = [index for index, name, is_here in self.symbols() if not is_here and name in names]
        for index in gone:
            info = begin + index * SYMBOL.size + 4
            self.raw[info] = STB_WEAK << 4 | self.raw[info] & 15  # a weak symbol may be missing
            if has_versions:
                struct.pack_into("<H", self.raw, self._table(DT_VERSYM) + 2 * index, VER_NDX_GLOBAL)
        self._forget_versions(libraries)
        kept = [(t, v) for t, v in self.entries if not (t == DT_NEEDED and self._string(v) in libraries)]
        kept += [(DT_NULL, 0)] * (len(self.entries) - len(kept))
        self.entries = kept
        for i, entry in enumerate(kept):
            struct.pack_into("<QQ", self.raw, self._at + 16 * i, *entry)

    def _forget_versions(self, libraries: set[str]) -> None:
        """Take libraries out of the list of versions that are asked of each."""
        count = self._value(DT_VERNEEDNUM)
        if not count:
            return
        start = at = self._table(DT_VERNEED)
        blocks = []
        for _ in range(count):
            version, entries, file, aux, step = struct.unpack_from("<HHIII", self.raw, at)
            blocks.append((at, version, entries, file, aux))
            at += step
        kept = [b for b in blocks if self._string(b[3]) not in libraries]
        if not kept:
            raise ElfError("nothing would be left in its list of versions")
        # The list begins where it did: the first that stays is moved there, its versions are found from there.
        places = [start, *(b[0] for b in kept[1:])]
        for (was, version, entries, file, aux), place, after in zip(kept, places, [*places[1:], 0], strict=True):
            step = after - place if after else 0
            struct.pack_into("<HHIII", self.raw, place, version, entries, file, was + aux - place, step)
        self.entries = [(t, len(kept) if t == DT_VERNEEDNUM else v) for t, v in self.entries]
