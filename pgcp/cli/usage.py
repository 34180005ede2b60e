"""How the command answers what it does not understand: one sentence, with what may have been meant."""

from __future__ import annotations

import argparse
import re
from difflib import get_close_matches
from typing import NoReturn

from pgcp.errors import InputError

SHORT_HELP = """\
pgcp-run maps a triangle mesh conformally to the plane, the disk or the sphere.

  pgcp-run bust.ply                            map a mesh; results go to bust_pgcp/
  pgcp-run bust.ply --target disk --write obj  map it to the unit disk, write an OBJ file with texture coordinates
  pgcp-run big.ply --patches 6 --workers 2     six patches, two worker processes

pgcp-run --demo maps a built-in surface. pgcp-run --help lists all options."""


class UsageError(InputError):
    """The command line cannot be understood."""


class Parser(argparse.ArgumentParser):
    """A parser whose mistakes are errors of one sentence."""

    def error(self, message: str) -> NoReturn:
        """Raise UsageError, with the nearest name that would have been understood."""
        near = self._near(message)
        raise UsageError(f"{message}{f'; did you mean {near}?' if near else ''} (--help lists the options)")

    def _near(self, message: str) -> str:
        """The option or choice that is nearest to the one that a message of argparse complains of, or nothing."""
        if unknown := re.match(r"unrecognized arguments: (--?[\w-]+)", message):
            return _nearest(unknown[1], list(self._option_string_actions))
        if wrong := re.match(r"argument (--[\w-]+).*: invalid choice: '([^']*)'", message):
            return _nearest(wrong[2], [str(choice) for choice in self._option_string_actions[wrong[1]].choices or ()])
        return ""


def _nearest(word: str, known: list[str]) -> str:
    return next(iter(get_close_matches(word, known, 1, 0.6)), "")
