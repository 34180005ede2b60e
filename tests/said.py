"""What a command says beside its progress."""

from __future__ import annotations

import re


def without_progress(said):
    """Standard error without the lines on stages that last, which a busy machine brings."""
    return re.sub(r"(?m)^ *\d+\.\d s: .*\n", "", said)
