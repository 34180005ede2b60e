"""Pictures to be put on surfaces: a checkerboard, or one from a file."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from pgcp.errors import BadFileError, InputError

CHECKER = "checker"
_SIZE, _SQUARES = 1024, 32
_MOST_PIXELS = 1 << 28


def checkerboard(size: int = _SIZE, squares: int = _SQUARES) -> Image.Image:
    """A checkerboard: light squares are warmer to the right, dark ones greener upwards, so that places can be told apart."""
    return board(size, size, size / squares)


def board(width: int, height: int, side: float) -> Image.Image:
    """Such a checkerboard of width x height texels, whose squares have sides of ``side`` texels, from the lower left on."""
    across, up = np.arange(width) + 0.5, (np.arange(height) + 0.5)[::-1]
    square, row = np.floor(across / side).astype(int), np.floor(up / side).astype(int)
    dark = (row[:, None] + square[None, :]) % 2 == 0
    u, v = np.broadcast_arrays(across[None, :] / width, up[:, None] / height)
    light = np.stack([0.90 + 0.08 * u, 0.93 - 0.10 * u, 0.97 - 0.25 * u], axis=-1)
    deep = np.stack([0.16 + 0 * v, 0.26 + 0.24 * v, 0.55 - 0.10 * v], axis=-1)
    return Image.fromarray((255 * np.where(dark[..., None], deep, light) + 0.5).astype(np.uint8))


def as_picture(source: Any) -> Image.Image:
    """A picture from "checker", a path, an array (height, width, 3) of bytes, or a picture; raises InputError for what is none.

    BadFileError where a file cannot be read or holds no picture.
    """
    if isinstance(source, Image.Image):
        return source.convert("RGB")
    if isinstance(source, np.ndarray):
        if source.shape[2:] != (3,) or source.dtype != np.uint8 or not source.size:
            raise InputError(f"a texture of shape {source.shape} and type {source.dtype}; expected (height, width, 3) of uint8")
        return Image.fromarray(source)
    if not isinstance(source, (str, Path)):
        raise InputError(f"a texture is {CHECKER!r}, a path, an array or a picture, not {type(source).__name__}")
    if source == CHECKER:
        return checkerboard()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            picture = Image.open(source)
        if picture.width * picture.height > _MOST_PIXELS:
            raise BadFileError(f"{source}: a texture of {picture.width} x {picture.height} pixels is too large")
        return picture.convert("RGB")
    except Image.DecompressionBombError as problem:
        raise BadFileError(f"{source}: the texture has too many pixels") from problem
    except UnidentifiedImageError as problem:
        raise BadFileError(f"{source}: it is no picture that can be read") from problem
    except (OSError, ValueError, SyntaxError) as problem:
        raise BadFileError(
            f"{source}: the picture cannot be read: {getattr(problem, 'strerror', None) or problem}"
        ) from problem


def as_png(source: Any) -> bytes:
    """The bytes of a PNG of such a picture."""
    out = io.BytesIO()
    as_picture(source).save(out, "png", compress_level=6)
    return out.getvalue()
