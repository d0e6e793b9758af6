"""Draws the examples of docs/explanation/verdicts.md: pictures degraded as prints degrade them, and the word for each.

``python docs/draw_verdicts.py`` writes ``docs/images/verdicts/*.png`` and prints likeness, word and PSNR of
each. The thresholds in ``magiclens/images/likeness.py`` were chosen by looking at these. The photograph is
NASA's portrait of Eileen Collins, in the public domain, as scikit-image brings it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images import art, luminance, resize, score, to_linear, write_png
from magiclens.images.likeness import likeness, word_for
from magiclens.images.text import text

IMAGES = Path(__file__).parent / "images" / "verdicts"
SIDE = 160


def letter() -> FloatArray:
    return text("A", SIDE)


def drawing() -> FloatArray:
    return art("panda", SIDE)


def photograph() -> FloatArray:
    import skimage.data

    return resize(to_linear(skimage.data.astronaut() / 255), (SIDE, SIDE))


def coloured() -> FloatArray:
    """A green heart on red of the same brightness."""
    red, green = (1.0, 0.0, 0.0), (0.0, 0.2126 / 0.7152, 0.0)
    return np.where(art("heart", SIDE)[..., :1] > 0.5, np.float32(green), np.float32(red))


def greyed(picture: FloatArray) -> FloatArray:
    return luminance(picture)[..., None]


def netted(picture: FloatArray, lines: int, wide_px: int, level: float) -> FloatArray:
    """A net of lines, as rounded borders of facets are."""
    on = np.arange(SIDE) * lines % SIDE < wide_px * lines
    return np.where((on[:, None] | on)[..., None], np.float32(level), picture)


def blurred(picture: FloatArray, sigma_px: float) -> FloatArray:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(picture, (sigma_px, sigma_px, 0)), np.float32)


def mixed(picture: FloatArray, share: float) -> FloatArray:
    """So much of the picture, the rest its own tiles in no order, as facets show that miss their patches."""
    count, wide = 32, SIDE // 32
    tiles = picture.reshape(count, wide, count, wide, -1).swapaxes(1, 2).reshape(count**2, wide, wide, -1)
    order = np.random.default_rng(1).permutation(count**2)
    other = tiles[order].reshape(count, count, wide, wide, -1).swapaxes(1, 2).reshape(picture.shape)
    return np.asarray(share * picture + (1 - share) * other, np.float32)


def noise(picture: FloatArray) -> FloatArray:
    return np.asarray(to_linear(np.random.default_rng(1).random(picture.shape)), np.float32)


EXAMPLES: Mapping[str, tuple[Callable[[], FloatArray], Callable[[FloatArray], FloatArray], str]] = {
    "letter-thin-lines": (letter, lambda p: np.asarray(0.5 * p + 0.5 * netted(p, 7, 1, 0.5), np.float32), "clear"),
    "drawing-noisy": (drawing, lambda p: np.asarray(0.6 * p + 0.4 * noise(p), np.float32), "clear"),
    "photograph-thin-lines": (photograph, lambda p: netted(p, 24, 1, 0.0), "clear"),
    "photograph-grey": (photograph, greyed, "clear"),
    "letter-blurred": (letter, lambda p: blurred(p, 4), "recognisable"),
    "drawing-net": (drawing, lambda p: netted(p, 24, 3, 0.0), "recognisable"),
    "photograph-net": (photograph, lambda p: netted(p, 24, 2, 0.0), "recognisable"),
    "letter-scattered": (letter, lambda p: mixed(p, 0.3), "hard to see"),
    "drawing-blurred": (drawing, lambda p: blurred(p, 7), "hard to see"),
    "photograph-half-scattered": (photograph, lambda p: mixed(p, 0.3), "hard to see"),
    "heart-grey": (coloured, greyed, "lost"),
    "letter-noise": (letter, noise, "lost"),
    "drawing-scattered": (drawing, lambda p: mixed(p, 0.05), "lost"),
    "photograph-scattered": (photograph, lambda p: mixed(p, 0.05), "lost"),
}
"""Target, what happens to it, and the word that eyes have for it, by the name of the file."""


def pictures() -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Name, picture as exposed, and target of every example."""
    for name, (target, degrade, _) in EXAMPLES.items():
        wanted = np.asarray(target(), np.float32)
        shown = degrade(wanted)
        yield name, np.clip(shown * np.float32(score(shown, wanted).gain), 0, 1), wanted


def main() -> None:
    IMAGES.mkdir(parents=True, exist_ok=True)
    for name, shown, wanted in pictures():
        write_png(IMAGES / f"{name}.png", shown)
        found = likeness(shown, wanted)
        shown_db = score(shown, wanted).psnr_db
        print(f"{name:26} {found:.2f}  {word_for(found):13} {shown_db:.1f} dB, eyes: {EXAMPLES[name][2]}")


if __name__ == "__main__":
    main()
