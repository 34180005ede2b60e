"""What a path may be instead where no file has it."""

from __future__ import annotations

import re
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path


def explain_missing(path: Path) -> str:
    """One sentence without its subject: why there is no file at a path, and which one may have been meant."""
    text = str(path)
    if scheme := re.match(r"(https?|ftp|s3|gs|file):/", text):
        return f"{scheme[1]} addresses are not read; download the file and name it"
    near: list[str] = []
    with suppress(OSError, ValueError):
        near = get_close_matches(path.name, [other.name for other in path.parent.iterdir() if other.is_file()], 1, 0.75)
    return f"there is no such file{f'; did you mean {path.with_name(near[0])}?' if near else ''}"
