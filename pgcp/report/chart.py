"""Text and axes, drawn with Pillow. All lengths are in pixels of a canvas that is made smaller by half in the end."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from PIL import Image, ImageDraw, ImageFont

INK, BLUE, RED = "#000000", "#29528c", "#b5442c"
TICK_SIZE, LABEL_SIZE = 22, 24
_TICK = 7
Point = tuple[float, float]
Room = tuple[float, float, float, float]


Face = ImageFont.FreeTypeFont | ImageFont.ImageFont
_OTHERS = (  # typefaces that systems have, of many scripts each
    "DejaVuSans.ttf", "NotoSans-Regular.ttf", "NotoSansCJK-Regular.ttc", "NotoSansArabic-Regular.ttf",
    "NotoSansHebrew-Regular.ttf", "NotoSansDevanagari-Regular.ttf", "NotoSansThai-Regular.ttf", "LiberationSans-Regular.ttf",
    "FreeSans.ttf", "unifont.otf", "wqy-microhei.ttc", "wqy-zenhei.ttc", "DroidSansFallbackFull.ttf", "Arial Unicode.ttf",
    "arialuni.ttf", "arial.ttf", "msyh.ttc", "msgothic.ttc", "malgun.ttf",
    "PingFang.ttc", "Hiragino Sans GB.ttc", "AppleSDGothicNeo.ttc",
)  # fmt: skip
_CYRILLIC = (
    "а=a б=b в=v г=g д=d е=e ж=zh з=z и=i к=k л=l м=m н=n о=o п=p р=r с=s т=t у=u ф=f х=kh ц=ts ч=ch ш=sh щ=shch "  # noqa: RUF001
    "ъ= ы=y ь= э=e ю=yu я=ya і=i є=ye ґ=g"  # noqa: RUF001
)
_GREEK = "α=a β=v γ=g δ=d ε=e ζ=z η=i θ=th ι=i κ=k λ=l μ=m ν=n ξ=x ο=o π=p ρ=r σ=s ς=s τ=t υ=y φ=f χ=ch ψ=ps ω=o"  # noqa: RUF001
_LATIN = {pair[0]: pair[2:] for words in (_CYRILLIC, _GREEK) for pair in words.split(" ")}


@cache
def font(size: int) -> Face:
    """The typeface that comes with Pillow, letters ``size`` high."""
    return ImageFont.load_default(size)


@cache
def _other(name: str, size: int) -> Face | None:
    """A typeface of the system, None where it has none of this name."""
    try:
        return ImageFont.truetype(name, size)
    except (OSError, ImportError):
        return None


def _has(face: Face, words: str) -> bool:
    """Whether a typeface has all letters: none looks like one that no typeface has."""
    missing = bytes(face.getmask("\uffff"))
    return all(letter == " " or bytes(face.getmask(letter)) != missing for letter in set(words))


@cache
def _legible(words: str) -> tuple[str, str]:
    """Words that can be drawn and the name of the typeface that has them, empty for Pillow's own.

    The first of the system's that has all letters; where none has, they are written out: in Latin letters, or as code points.
    """
    words = unicodedata.normalize("NFC", "".join(letter if letter.isprintable() else " " for letter in words))
    if _has(font(TICK_SIZE), words):
        return words, ""
    for name in _OTHERS:
        face = _other(name, TICK_SIZE)
        if face is not None and _has(face, words):
            return words, name
    return plain(words), ""


def plain(words: str) -> str:
    """Words in the letters of any typeface: without accents, Cyrillic and Greek in Latin letters, others as code points."""
    out = []
    for letter in words:
        bare = "".join(c for c in unicodedata.normalize("NFKD", letter) if not unicodedata.combining(c))
        latin = _LATIN.get(bare.lower())
        if latin is not None:
            out.append(latin if bare.islower() else latin.capitalize())
        else:
            out.append("".join(c if " " <= c <= "~" else f"[{ord(c):X}]" if c.isprintable() else " " for c in bare))
    return "".join(out)


def centred(draw: ImageDraw.ImageDraw, place: Point, words: str, size: int, width: float, fill: str = INK) -> None:
    """Write words in the middle of a place, smaller where they are wider than ``width``, shortened where too small then."""
    words, name = _legible(words)

    def face(height: int) -> Face:
        """The typeface in a size."""
        return (_other(name, height) if name else None) or font(height)

    size = max(min(size, int(size * width / max(face(size).getlength(words), 1.0))), 14)
    while len(words) > 4 and face(size).getlength(words) > width:
        words = words[: len(words) // 2 - 2] + "..." + words[-(len(words) // 2 - 2) :]
    draw.text(place, words, fill, face(size), "mm")


def upwards(canvas: Image.Image, place: Point, words: str, size: int) -> None:
    """Write words from below upwards, their middle at a place."""
    width, height = math.ceil(font(size).getlength(words)) + 4, 2 * size
    label = Image.new("L", (width, height))
    ImageDraw.Draw(label).text((width / 2, height / 2), words, 255, font(size), "mm")
    label = label.rotate(90, expand=True)
    canvas.paste(INK, (round(place[0] - height / 2), round(place[1] - width / 2)), label)


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis: the values at its ends, where its ticks are, and what is written there; ``10^3`` raises the 3."""

    low: float
    high: float
    ticks: list[float]
    labels: list[str]
    minor: list[float]
    log: bool = False

    def share(self, value: float) -> float:
        """Where a value lies on the axis, from 0 to 1."""
        if self.log:
            return (math.log(value) - math.log(self.low)) / (math.log(self.high) - math.log(self.low))
        return (value - self.low) / (self.high - self.low)


def linear_axis(low: float, high: float, margins: Point = (0.05, 0.05), most: int = 9) -> Axis:
    """An axis with up to ``most`` round ticks, and margins beyond the values on it, as shares of what they span."""
    if not high - low > 1e-12 * max(abs(low), abs(high)):
        wider = 0.05 * max(abs(low), abs(high)) or 1.0
        low, high = low - wider, high + wider
    span = high - low
    low, high = low - margins[0] * span, high + margins[1] * span
    power = 10.0 ** math.floor(math.log10((high - low) / most))
    step, digits = next(
        (power * m, d) for m, d in ((1, 0), (2, 0), (2.5, 1), (5, 0), (10, -1)) if (high - low) / (power * m) <= most
    )
    decimals = digits - round(math.log10(power))
    ticks = [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
    if -7 < decimals < 9 and max(abs(low), abs(high)) < 1e7:
        labels = [f"{tick:.{max(decimals, 0)}f}" for tick in ticks]
    else:
        labels = [f"{tick:.6g}" for tick in ticks]
    return Axis(low, high, ticks, labels, [])


def log_axis(low: float, high: float, most: int = 8) -> Axis:
    """A logarithmic axis from ``low`` to ``high``, both positive, with ticks at powers of ten, or between if these are few."""
    wider = max((high / low) ** 0.05, 1.001)
    low, high = max(low / wider, 1e-307), min(high * wider, 1e307)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    between = [m * 10.0**d for d in decades for m in range(1, 10) if low <= m * 10.0**d <= high]
    every = len(decades) // most + 1
    for steps in ((1,), (1, 3), (1, 2, 5), range(1, 10)):
        marks = [(m, d) for d in decades if d % every == 0 for m in steps if low <= m * 10.0**d <= high]
        if len(marks) >= 3:
            break
    labels = [f"10^{d}" if m == 1 else f"{m}·10^{d}" for m, d in marks]
    ticks = [m * 10.0**d for m, d in marks]
    if len(ticks) < 2:
        ticks = [low * wider, high / wider]
        labels = [f"{tick:.3g}" for tick in ticks]
    return Axis(low, high, ticks, labels, between if every == 1 else [], log=True)


def _label_width(label: str) -> float:
    head, _, raised = label.partition("^")
    return font(TICK_SIZE).getlength(head) + font(TICK_SIZE * 3 // 4).getlength(raised)


def _label(draw: ImageDraw.ImageDraw, place: Point, label: str) -> None:
    """Write a tick's label to the right of a place."""
    x, y = place
    head, _, raised = label.partition("^")
    draw.text((x, y), head, INK, font(TICK_SIZE), "lm")
    draw.text((x + font(TICK_SIZE).getlength(head), y - 0.4 * TICK_SIZE), raised, INK, font(TICK_SIZE * 3 // 4), "lm")


@dataclass(frozen=True, slots=True)
class Scale:
    """What colours stand for: an axis, and colours at even distances along it."""

    axis: Axis
    stops: tuple[tuple[float, float, float], ...]

    @classmethod
    def between(cls, low: float, high: float, stops: tuple[tuple[float, float, float], ...], most: int = 6) -> Scale:
        """Colours from one value to another, evenly, with up to ``most`` ticks."""
        return cls(linear_axis(low, high, (0.0, 0.0), most), stops)


def colour_bar(canvas: Image.Image, room: Room, scale: Scale) -> None:
    """Draw a bar of colours from left to right, with ticks and labels below it."""
    draw, axis = ImageDraw.Draw(canvas), scale.axis
    x0, y0, x1, y1 = (round(edge) for edge in room)
    y1 -= 2 * _TICK + TICK_SIZE
    for x in range(x0, x1 + 1):
        place = (x - x0) / (x1 - x0) * (len(scale.stops) - 1)
        k = min(int(place), len(scale.stops) - 2)
        mixed = [a + (place - k) * (b - a) for a, b in zip(scale.stops[k], scale.stops[k + 1], strict=True)]
        draw.line((x, y0, x, y1), tuple(round(255 * part) for part in mixed))
    draw.rectangle((x0, y0, x1, y1), outline=INK, width=2)
    for tick, label in zip(axis.ticks, axis.labels, strict=True):
        x = round(x0 + (x1 - x0) * axis.share(tick))
        draw.line((x, y1, x, y1 + _TICK), INK, 2)
        _label(draw, (x - 0.5 * _label_width(label), y1 + 2 * _TICK + 0.5 * TICK_SIZE), label)


class Chart:
    """A chart in a room (left, upper, right and lower edge) of a canvas, with axes below, at the left, perhaps at the right."""

    def __init__(self, canvas: Image.Image, room: Room, below: Axis, left: Axis, right: Axis | None = None) -> None:
        self.canvas, self.room = canvas, room
        self.below, self.left, self.right = below, left, right
        self._draw = ImageDraw.Draw(canvas)
        x0, y0, x1, y1 = room
        beside = [
            0.0 if axis is None else 2 * _TICK + max(map(_label_width, axis.labels), default=0.0) for axis in (left, right)
        ]
        self.edges = round(x0 + 1.8 * LABEL_SIZE + beside[0]), round(y0), round(x1 - beside[1]), round(y1 - 3.2 * LABEL_SIZE)

    def place(self, x: float, y: float, beside: Axis | None = None) -> Point:
        """Where a point is drawn, its y on the axis at the left if nothing else is said."""
        x0, y0, x1, y1 = self.edges
        return x0 + (x1 - x0) * self.below.share(x), y1 - (y1 - y0) * (beside or self.left).share(y)

    def write(self, below: str, left: str = "") -> None:
        """Write what the axes stand for."""
        x0, y0, x1, y1 = self.edges
        self._draw.text((0.5 * (x0 + x1), self.room[3] - 0.6 * LABEL_SIZE), below, INK, font(LABEL_SIZE), "mm")
        upwards(self.canvas, (self.room[0] + 0.6 * LABEL_SIZE, 0.5 * (y0 + y1)), left, LABEL_SIZE)

    def bar(self, begin: float, end: float, height: float, colour: str) -> None:
        """Draw a bar from 0 to a height."""
        self._draw.rectangle((*self.place(begin, height), *self.place(end, 0.0)), colour)

    def line(self, points: Sequence[Point], colour: str, beside: Axis | None = None, dots: int = 0) -> None:
        """Draw a line through points, with dots of that radius on them."""
        places = [self.place(*point, beside) for point in points]
        self._draw.line(places, colour, 5 if dots else 3, "curve")
        for x, y in places if dots else ():
            self._draw.ellipse((x - dots, y - dots, x + dots, y + dots), colour)

    def frame(self) -> None:
        """Draw the frame, with ticks and their labels."""
        x0, _, x1, y1 = self.edges
        self._draw.rectangle(self.edges, outline=INK, width=2)
        for tick, label in zip(self.below.ticks, self.below.labels, strict=True):
            x, _ = self.place(tick, self.left.low)
            self._draw.line((x, y1, x, y1 + _TICK), INK, 2)
            self._draw.text((x, y1 + 2 * _TICK), label, INK, font(TICK_SIZE), "mt")
        self._ticks_beside(self.left, x0, -1)
        if self.right is not None:
            self._ticks_beside(self.right, x1, 1)

    def _ticks_beside(self, axis: Axis, edge: float, side: int) -> None:
        for tick in axis.minor:
            _, y = self.place(self.below.low, tick, axis)
            self._draw.line((edge, y, edge + side * _TICK * 0.6, y), INK, 1)
        for tick, label in zip(axis.ticks, axis.labels, strict=True):
            _, y = self.place(self.below.low, tick, axis)
            self._draw.line((edge, y, edge + side * _TICK, y), INK, 2)
            _label(self._draw, (edge + side * 2 * _TICK - (_label_width(label) if side < 0 else 0.0), y), label)
