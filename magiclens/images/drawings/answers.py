"""Black silhouettes that answer questions: presidents, a tower and others (picture units, y down)."""

from __future__ import annotations

from itertools import chain

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.drawings.clipart import cut, ink
from magiclens.images.vector import (
    Layer,
    arc,
    blob,
    both,
    brush,
    ellipse,
    polygon,
    rectangle,
    stroke,
    turned,
)


def _outline(shape: FloatArray, width: float) -> FloatArray:
    """The outline of a stroke along a closed outline."""
    return brush(np.concatenate([shape, shape[:2]]), width)


def lincoln() -> list[Layer]:
    """Abraham Lincoln from the front, with stovepipe hat, chin beard and bow tie."""
    return [
        ink(*both(blob("49,66! 40,72 28,78 16,84 10,100! 50,100!"))),
        cut(polygon("40,74 60,74 50,98"), *both(stroke("39,77 43,88 49.5,99", 0.6, 1.4, 0.6))),
        ink(*both(polygon("50,85 41,80 41,91")), ellipse(50, 85.5, 2.4)),
        ink(*both(ellipse(33.5, 50, 3.4, 5.5))),
        cut(*both(ellipse(33.8, 50, 1.6, 3.4))),
        cut(blob("34,60! 36,70 43,80.5 50,83 57,80.5 64,70 66,60!")),
        ink(blob("50,24! 64,26 67,40 66.5,56 63.5,70 57,79 50,81.5 43,79 36.5,70 33.5,56 33,40 36,26")),
        cut(blob("50,30! 60,32 62.5,40 61.5,52 58,62 54,66.5 50,67.5 46,66.5 42,62 38.5,52 37.5,40 40,32")),
        ink(*both(stroke("53.5,41.5 57.5,40.5 61.5,42", 1.6, 2.6, 1.4), ellipse(57, 45.5, 1.8))),
        ink(stroke("49,43 47.6,53 50,56 52.6,55.2", 0.9, 1.5, 2.2, 1)),
        ink(stroke("45,61.5 50,60.6 55,61.5", 0.8, 1.8, 0.8)),
        ink(*both(stroke("59.5,50 58.3,54 59,57", 0.5, 1.2, 0.5))),
        ink(blob("33,2! 50,0.5 67,2! 66,16 66,34! 34,34! 34,16")),
        ink(blob("21,29! 34,31.5 50,32 66,31.5 79,29! 66,37 34,37")),
        cut(stroke("33.5,26 50,27.4 66.5,26", 1.8)),
    ]


def washington() -> list[Layer]:
    """George Washington in profile, looking to the left, with a wig that has side curls and a bow."""
    face = "41,14 36,19 33.5,26 33.5,31.5! 34,34 31,39.5 26.5,47! 28,49.5 32,51! 31.3,54 30,56.8! 32,58.2! 30.7,61"
    chin = "32.7,63.5 30.5,68 31.5,73.5 35.5,77 41.5,76"
    wig = blob("41,15! 46,7 56,3 67,5 76,12 80,24 78,38 72,51! 66,60 57,62! 54,52 52,43 47,36 45,26")
    waves = (
        "50,15 58,10.5 67,13.5 73,23 73.5,35",
        "50,22.5 58,18.5 65,21.5 69,30 69,38.5",
        "53,31 60,26.5 64,30 65.5,38",
    )
    rolls = [ellipse(59, y, 9.5, 5.2, -6) for y in (44.5, 55)]
    ribbon = (
        blob("73,54! 80,45 90,43! 91,51 88,58!"),
        blob("73,54! 83,57 91,65! 84,69 75,64!"),
        ellipse(74, 54.5, 3.4, 4),
    )
    queue = blob("70,56! 78,60 84,74 83,92! 75,85 71,74 67,64!")
    return [
        ink(blob("46,80! 62,66 74,66 92,80 99,100! 16,100! 24,89 36,82")),
        cut(blob(f"{face} {chin}! 42,83! 56,83! 64,76! 67,60! 60,20!")),
        ink(stroke(f"{face} {chin}", 2.8), stroke("41,76 42,80", 2.8)),
        cut(blob("41.5,80! 52,82 62,74! 64,81 52,89! 50,96 42,102! 34,98 38,89!")),
        ink(stroke("42,81 52,83 63,75", 2), stroke("45,86 42,91 43,99", 2, 0.8), stroke("50,86 47,91", 2, 0.8)),
        ink(stroke("57,62 55,68 48,73", 2.2, 1.6, 0.6)),
        cut(_outline(queue, 2.6)),
        ink(queue),
        cut(stroke("71,76 77,78 84,74", 1.2), stroke("74,84 79,86 84,82", 1.2)),
        cut(_outline(ribbon[1], 2)),
        cut(wig),
        ink(_outline(wig, 3)),
        ink(*(stroke(wave, 1, 2.6, 2.6, 1) for wave in waves)),
        ink(*rolls),
        cut(*(ellipse(59, y, 7.1, 2.8, -6) for y in (44.5, 55))),
        ink(*(stroke(f"55,{y + 0.4} 59,{y - 0.9} 62,{y}", 0.6, 1.6, 0.6) for y in (44.5, 55))),
        ink(*ribbon),
        cut(stroke("76.5,52.5 80,49.5 84,48", 0.6, 1.4, 0.6), stroke("77,57 81,59 85,62.5", 0.6, 1.4, 0.6)),
        ink(stroke("36,35.5 39.5,33 44.5,34.5", 1, 2.6, 1), ellipse(39.8, 39, 1.8, 2.1)),
        ink(stroke("32.5,58.5 37.5,58.2", 1.6, 0.6), stroke("31.5,48.8 33.5,47 33,44.8", 1.4, 0.5)),
    ]


def eiffel_tower() -> list[Layer]:
    """The Eiffel tower with its arch and lattice."""
    return [
        ink(stroke("50,1 50,12", 1.6), polygon("47.5,9 52.5,9 53.5,17 46.5,17")),
        _girders("20 26 34 44 56"),
        _girders("59 73", hollow=0.42),
        _girders("76 86 97", hollow=0.54),
        ink(rectangle(44, 16, 56, 20.5), rectangle(36, 55, 64, 60), rectangle(27, 72, 73, 77.5)),
        ink(brush(arc(50, 97, 20, 180, 360), 3.2)),
        ink(*both(rectangle(8, 95.5, 36, 100))),
    ]


def _half_width(y: float) -> float:
    """Half the tower's width at a height: narrow for long, wide at the feet."""
    return float(np.interp(y, (16, 30, 45, 57, 66, 77, 88, 98), (3.2, 5.2, 8, 11, 15, 21, 28.5, 37.5)))


def _girders(levels: str, hollow: float = 0.0) -> Layer:
    """Crossed girders between levels, in one leg or two; ``hollow`` is the share of the width between the legs."""
    right = [np.array((50 + _half_width(y), y)) for y in map(float, levels.split())]
    left = [np.array((50 + (hollow or -1) * (x - 50), y)) for x, y in right]
    posts = [brush(np.array(post), 2.8) for post in (left, right)]
    crosses = [((left[k], right[k + 1]), (right[k], left[k + 1])) for k in range(len(right) - 1)]
    beams = [brush(np.array(beam), 2) for beam in (*chain(*crosses), *zip(left, right, strict=True))]
    return ink(*(both(*posts, *beams) if hollow else (*posts, *beams)))


def dinosaur() -> list[Layer]:
    """A roaring tyrannosaur that looks to the right."""
    body = (
        "57,24 64,10 72,4.5 79,4.5 84,8 93,10.5 98,14.5 99,19 97.5,22.5! 88,23.5 75,27! 83,34.5 93,35! 92,40 83,42.5"
        " 75,42.5 72,49 70,57 64,66 52,70 40,66 26,61 12,54 -2,42! 14,46 26,44 36,38 46,33"
    )
    near = "38,54 46,46 56,48 62,58 60,68 54,76 53,82! 55,88 58,91 66,93 68,98! 46,98! 47,90 44,83 44,77 38,68"
    far = "60,56 68,58 72,66 68,74 68,80! 71,87 80,91 82,96! 63,96! 63,88 60,80 60,72"
    upper = [
        polygon(f"{x},{y - 1.5} {x + 3.4},{y - 1.9} {x + 2},{y + 4.6}")
        for x, y in ((80, 25), (85, 23.6), (90, 22.8), (94.5, 22))
    ]
    lower = [polygon(f"{x},{y + 1.5} {x + 3.2},{y + 1.7} {x + 1.2},{y - 3.8}") for x, y in ((83, 35.2), (88, 35.6))]
    stripes = (
        "38,36 41,42 41,48",
        "47,31.5 50,37 50.5,42",
        "56,25 60,30 61,35",
        "28,43 31,47 31.5,52",
        "19,45 21.5,48.5 22,52",
    )
    toes = ("56.5,98.5 59,95.5", "61.5,98.5 64,95.5", "71,96.5 73.5,93.5", "76,96.5 78.5,93.5")
    return [
        ink(blob(far)),
        ink(blob(body)),
        ink(*upper, *lower),
        cut(*(stroke(stripe, 2.6, 1.6, 0.4) for stripe in stripes)),
        cut(stroke("42,70 38,64 38,55 45,47 55,48 62,58 60,68 55,75", 0.4, 2.6, 2.6, 2.6, 0.4)),
        cut(stroke("54,80 54.5,86 58,91", 0.4, 1.4, 1.4)),
        ink(blob(near)),
        cut(stroke("64,50 66,56 70,59", 0.4, 1.6, 1.6)),
        ink(stroke("67,51 73,57 79,55 81,51", 6.5, 4.5, 3.4, 0.8), stroke("79,55 82.5,56 85,54", 3, 2.2, 0.8)),
        cut(*(stroke(toe, 1.5, 0.6) for toe in toes)),
        cut(ellipse(77, 12, 2.8)),
        ink(ellipse(77.7, 12.4, 1.5)),
        cut(ellipse(94, 14.6, 1)),
    ]


def apple() -> list[Layer]:
    """An apple with a leaf and a gleam."""
    half = blob("50,32! 58,27 70,25 84,33 90,50 86,70 76,88 64,96 50,92! 49,60!")
    return [
        ink(*both(half)),
        ink(stroke("50,33 50.5,22 55,11", 4, 3.5, 5)),
        ink(blob("54,20! 60,8 72,3 85,5! 81,16 70,22")),
        cut(stroke("57,18.5 67,13.5 79,8", 0.5, 1.5, 0.5)),
        cut(stroke("43,32.5 50,35.5 57,32.5", 0.5, 2.4, 0.5)),
        cut(stroke("20,62 18,48 23,38 31,33.5", 0.8, 4.5, 4.5, 1)),
    ]


def lightbulb() -> list[Layer]:
    """A shining bulb with its filament."""
    rays = [turned(stroke("50,8 50,-3", 4, 4), 45 * k - 90, (50, 42)) for k in range(5)]
    neck = blob("24,52! 30,62 35.5,69 37,77! 63,77! 64.5,69 70,62 76,52!")
    filament = "43,77 43,64 37,51! 43.5,56 46,47! 50,55 54,47! 56.5,56 63,51! 57,64 57,77"
    return [
        ink(ellipse(50, 42, 28), neck),
        cut(stroke(filament, 1.8)),
        cut(stroke("29.5,47 29,37 34,28 42,22.5", 0.8, 3.6, 3.6, 0.8)),
        ink(*(stroke(f"39.5,{y} 60.5,{y}", 4.4) for y in (81.5, 88))),
        ink(blob("41,92! 59,92! 56,98 50,99.5 44,98")),
        ink(*rays),
    ]
