"""Unpack what is compressed, but no more than it can be believed to hold."""

from __future__ import annotations

import io
import zipfile
import zlib

from pgcp.errors import BadFileError

_MOST_UNPACKED = 16 << 20  # bytes, and so many times the compressed size
_MOST_TIMES = 100
_STEP = 1 << 24
GZIP = b"\x1f\x8b"


def most_unpacked(size: int) -> int:
    """How many bytes so many compressed ones may become."""
    return max(_MOST_UNPACKED, _MOST_TIMES * size)


def check_unpacked_size(data: bytes) -> None:
    """Raise BadFileError where a zip archive unpacks to far more than it is; other data pass."""
    if not data.startswith(b"PK"):
        return
    try:
        size = sum(member.file_size for member in zipfile.ZipFile(io.BytesIO(data)).infolist())
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as problem:
        raise BadFileError(f"it is no whole zip archive: {' '.join(str(problem).split())}"[:200]) from problem
    if size > most_unpacked(len(data)):
        raise BadFileError(f"its archive of {len(data)} bytes unpacks to {size}; at most {most_unpacked(len(data))} are read")


def unpacked_gzip(data: bytes) -> bytes:
    """The contents of gzip data, all members; raises BadFileError where they are cut off, wrong, or too many."""
    out, left, most = [], data, most_unpacked(len(data))
    size = 0
    while left.strip(b"\x00"):
        member = zlib.decompressobj(16 + zlib.MAX_WBITS)
        try:
            while not member.eof and left:
                part = member.decompress(left, _STEP)
                size += len(part)
                if size > most:
                    raise BadFileError(f"its {len(data)} compressed bytes unpack to more than {most}, which are not read")
                out.append(part)
                left = member.unconsumed_tail or member.unused_data
        except zlib.error as problem:
            raise BadFileError(f"its gzip data are wrong: {problem}") from problem
        if not member.eof:
            raise BadFileError(f"its gzip data are cut off after {len(data)} bytes")
    return b"".join(out)
