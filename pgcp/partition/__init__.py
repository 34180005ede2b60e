"""The folder partition/ at the top of a checkout, as ``pgcp.partition``; an installed package has the folder itself here."""

from pathlib import Path
from typing import TYPE_CHECKING

__path__ = [str(Path(__file__).resolve().parents[2] / "partition")]

if TYPE_CHECKING:
    from partition import *  # noqa: F403
else:
    _door = Path(__path__[0], "__init__.py")
    exec(compile(_door.read_bytes(), str(_door), "exec"))
