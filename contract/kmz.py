"""KML and KMZ: the documents of a file's content. Standard library."""

from __future__ import annotations

import io
import zipfile
import zlib

from contract.errors import InputError

ZIP = b"PK"  # how an archive begins


def kml_documents(data: bytes, most_bytes: int) -> list[bytes]:
    """Return a KML document, or those of a KMZ, doc.kml first: what it links to in the archive is meant too.

    Raises InputError for an archive that is damaged, has none, or more than `most_bytes` of them unpacked.
    """
    if data[:2] != ZIP:
        return [data]
    found, left = [], most_bytes
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = [name for name in archive.namelist() if name.lower().endswith(".kml")]
            if not names:
                raise InputError("not KMZ: no .kml in the archive")
            for name in sorted(names, key=lambda name: name != "doc.kml"):
                with archive.open(name) as stream:
                    found.append(stream.read(left + 1))
                left -= len(found[-1])
                if left < 0:
                    raise InputError(f"KMZ: its documents are larger than {most_bytes // 1_000_000} MB")
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError, EOFError, ValueError, zlib.error) as error:
        raise InputError(f"not KMZ ({error})") from error
    return found
