"""Black silhouettes with white details, as layers from back to front (picture units, y down)."""

from __future__ import annotations

import numpy as np

from magiclens.contract.artifacts import FloatArray
from magiclens.images.vector import (
    Layer,
    arc,
    blob,
    both,
    brush,
    curve,
    ellipse,
    flat,
    polygon,
    rectangle,
    stroke,
    turned,
)


def ink(*outlines: FloatArray) -> Layer:
    """A layer that is black inside the outlines."""
    return Layer(outlines, flat(0.0))


def cut(*outlines: FloatArray) -> Layer:
    """A layer that is white inside the outlines."""
    return Layer(outlines, flat(1.0))


def five_points(x: float, y: float, radius: float) -> FloatArray:
    """A regular five-pointed star, one point up."""
    angle = np.radians(36 * np.arange(10) - 90)
    reach = np.where(np.arange(10) % 2, 0.382 * radius, radius)
    return np.stack([x + reach * np.cos(angle), y + reach * np.sin(angle)], -1)


def panda() -> list[Layer]:
    """A sitting panda, seen from the front."""
    arm = "22,58 21,69 30,78 41,77"
    pads = (ellipse(24.5, 91, 6, 4.6, -20), ellipse(17.5, 85, 2.3), ellipse(24, 81.5, 2.3), ellipse(31, 82, 2.3))
    return [
        ink(*both(ellipse(25, 13, 10.5)), ellipse(50, 70, 32, 27)),
        cut(ellipse(50, 80, 21, 14.5)),
        cut(*both(stroke(arm, 20, 19))),
        ink(*both(stroke(arm, 17, 15))),
        cut(*both(ellipse(27, 89, 17, 14, -20))),
        ink(*both(ellipse(27, 89, 15, 12, -20))),
        cut(*both(*pads)),
        cut(ellipse(50, 32, 35, 28)),
        ink(ellipse(50, 32, 33, 26)),
        cut(ellipse(50, 32, 30, 23)),
        ink(*both(ellipse(36, 32, 7.6, 10.5, 32)), ellipse(50, 42, 5, 3.4)),
        ink(stroke("50,43 50,47", 1.6), *both(stroke("50,47 46,49.5 42.5,47.5", 1.6))),
        cut(*both(ellipse(38, 30.5, 2.6))),
    ]


def bat() -> list[Layer]:
    """A bat with spread wings."""
    half = blob(
        "49,33! 53,31 56.5,19! 61,31 62,41 69,42 77,34 80,20! 92,28 100,46! 93,50 89,68! 81.5,64 75,80! 68.5,72"
        " 61.5,81! 56.5,82 50,95! 49,60!"
    )
    fingers = (stroke("79.5,28 81,42 88,62", 0.4, 1.3, 0.4), stroke("78.5,29 75.5,46 74.5,74", 0.4, 1.3, 0.4))
    return [
        ink(*both(half)),
        cut(*both(ellipse(55, 39, 2.6, 1.8, -20), polygon("51,46 54,46 52.5,52"), *fingers)),
    ]


def penguin() -> list[Layer]:
    """A standing penguin that looks to the left."""
    toes = [stroke(f"{x},98.5 {x + 3},95", 1.5, 0.6) for x in (27, 33, 39, 50.5, 56.5, 62.5)]
    return [
        ink(ellipse(35, 95, 14, 5, -4), ellipse(58, 95.5, 14, 5)),
        cut(*toes),
        ink(
            blob(
                "45,3 36,7 31,14! 17,20! 31,23.5! 31,31 24,43 20,60 23,78 35,91 55,93 70,87! 86,95! 79,80 78,60"
                " 70,40 61,27 60,14 54,5"
            )
        ),
        ink(blob("58,30! 70,38 82,53 90,73! 77,69 66,58")),
        cut(blob("34,29! 43,32 53,43 58,59 55,77 46,88 37,87 29,78 25,61 28,45")),
        cut(ellipse(50.5, 25.5, 4.2, 7, 30)),
        cut(ellipse(42, 14.5, 3.6)),
        ink(ellipse(41, 14.8, 1.9)),
        cut(stroke("60,38 62,52 70,64 80,72", 0.5, 2.2, 2, 0.5)),
        cut(stroke("19,20.2 26,20.6 32,20", 0.3, 1, 0.3)),
    ]


def whale() -> list[Layer]:
    """A whale that swims to the left and spouts water, with its tail up."""
    return [
        ink(
            blob(
                "4,62 8,48 22,39 42,38 58,46 72,57 81,54 85,42 84,34! 74,32 68,21! 80,21 88,30! 93,20 104,17! 100,30"
                " 92,37! 95,52 90,70 76,82 54,88 30,88 12,80"
            )
        ),
        cut(blob("5,66! 16,70 30,70 44,66! 46,76 56,85! 40,86.5 26,85 12,78")),
        ink(stroke("10,75 30,78 46,76", 1.2), stroke("20,80 36,82.5 50,81", 1.2)),
        cut(ellipse(34, 59, 3.4)),
        ink(ellipse(33.4, 59.4, 1.8)),
        cut(blob("50,70! 60,69 68,80 66,94! 54,90 48,80")),
        ink(blob("52,72 60,72 65.5,81 64.5,91! 55,87.5 50.5,80")),
        ink(stroke("29,35 27,24 20,18 12,22", 3.5, 5, 3, 1), stroke("29,35 31,23 38,16 47,20", 3.5, 5, 3, 1)),
        ink(ellipse(10, 28, 2.2, 3), ellipse(48.5, 26.5, 2.2, 3), ellipse(29, 13, 2.2, 3.2)),
    ]


def cat() -> list[Layer]:
    """A sitting cat, seen from the front, with its tail on the right."""
    whiskers = [stroke(f"40,{y} 32,{y - 2 + k} 25,{y - 2 + 3 * k}", 1, 0.3) for k, y in enumerate((29, 31, 33))]
    return [
        ink(stroke("64,88 80,91 89,82 84,70 86,60 92,58", 9, 9, 8, 7)),
        ink(blob("50,38 62,42 70,58 76,80 72,93 50,95 28,93 24,80 30,58 38,42")),
        cut(ellipse(50, 26, 26, 21.5)),
        ink(ellipse(50, 26, 24, 19.5), *both(blob("27,24! 26,2! 44,10!"))),
        cut(*both(polygon("30.5,15 30,8 37,11"))),
        cut(*both(blob("33,25! 38,20 44,26! 38,28.5"))),
        ink(*both(ellipse(39, 24, 1.4, 3.4))),
        cut(polygon("47,32 53,32 50,35.5"), *both(stroke("50,35 48,38.5 44.5,38", 1.2)), *both(*whiskers)),
        cut(*both(stroke("42,62 43,80 41,94", 0.6, 1.4)), *both(stroke("25,84 30,72 36,70", 1.2, 0.6))),
    ]


def rabbit() -> list[Layer]:
    """A sitting rabbit that looks to the left."""
    return [
        ink(blob("36,32 28,16 33,2 40,12 42,32"), blob("42,30 46,10 56,2 57,18 50,34")),
        cut(blob("37,26 33,16 34,8 38,16"), blob("47,26 50,14 54,8 53,19")),
        ink(ellipse(82, 78, 9)),
        cut(blob("34,52 56,44 76,56 82,78 70,94 36,95")),
        ink(blob("36,50 54,44 73,54 79,76 70,91 50,93 38,92 32,70")),
        ink(blob("18,46 22,38 32,30 44,30 52,40 50,54 40,60 26,56 19,52")),
        ink(blob("34,60 46,62 42,80 44,88 42,94 28,94 26,91 32,88"), ellipse(58, 92, 18, 4.5)),
        cut(ellipse(33, 42, 2.6), stroke("20,50 25,51 28,49", 0.9)),
        ink(ellipse(32.6, 42.3, 1.4)),
        cut(stroke("46,84 48,70 60,64 71,70 74,80", 0.5, 1.8, 1.8, 0.5), stroke("45,93 47,88 56,87", 1.4, 0.6)),
    ]


def owl() -> list[Layer]:
    """An owl on a branch, seen from the front."""
    feathers = [
        stroke(f"{x - 3.2},{y} {x},{y + 4} {x + 3.2},{y}", 1.2)
        for y, row in ((52, (43, 50, 57)), (60, (39.5, 46.5, 53.5, 60.5)), (68, (43, 50, 57)))
        for x in row
    ]
    return [
        ink(
            stroke("4,88 30,85 70,89 96,85", 5, 7, 6, 4),
            blob("10,86! 12,76 22,74! 20,84"),
            blob("80,90! 90,93 94,101! 82,98"),
        ),
        ink(stroke("50,78 47,94 46,99", 10, 8, 5), stroke("50,78 54,94 55,98", 10, 8, 5)),
        ink(blob("24,6! 36,12 50,14 64,12 76,6! 78,22 80,42 79,62 68,82 50,88 32,82 21,62 20,42 22,22")),
        cut(*both(ellipse(37.5, 30, 13))),
        ink(*both(ellipse(38.5, 30, 8.5))),
        cut(*both(ellipse(41, 27, 2.8))),
        cut(polygon("45.5,36 54.5,36 50,47"), *feathers),
        cut(*both(stroke("29,50 27,62 33,76", 0.6, 1.6, 0.6))),
        cut(*both(stroke("41,82 41,89", 3.2), stroke("46,84 46,91", 3.2))),
        ink(*both(stroke("41,83.5 41,88.5", 1.2), stroke("46,85 46,90", 1.2))),
    ]


def elephant() -> list[Layer]:
    """An elephant that walks to the left, with its trunk raised."""
    return [
        ink(stroke("91,42 97,52 96,64", 2.6, 1.8), ellipse(96, 66, 2, 3.5)),
        ink(blob("32,22 50,22 72,24 89,34 94,52 91,72! 60,71 38,72! 28,50")),
        ink(blob("38,62! 52,62! 50,78 51.5,95! 36,95! 37,80"), blob("75,60! 93,50! 91,74 93,95! 77,95! 78,78")),
        ink(blob("52,62! 64,62! 62,78 63,92! 53,92! 54,80"), blob("68,62! 80,62! 76,78 77,92! 66,92! 68,80")),
        ink(
            blob(
                "17,36 20,27 27,21 36,21 46,26 48,42 42,56 30,60 25,56 20,62 13,65 5,60 1,46 3,32 6,22! 13,23! 10.5,34"
                " 10.5,45 14,48"
            )
        ),
        cut(blob("32,53! 26,66 14,70! 20,63 25,54!")),
        cut(stroke("38,25 48,24 56,32 56,47 47,60 40,60 36,48", 0.6, 2, 2, 2, 0.6)),
        cut(ellipse(25, 36, 2.6)),
        ink(ellipse(24.6, 36.3, 1.3)),
        cut(*(ellipse(x, 95, 1.9, 2.4) for x in (39.5, 44, 48.5, 80.5, 85, 89.5))),
        cut(
            *(stroke(f"{x},{y} {x + 3},{y - 1} 14,{y + 0.5}", 0.5, 1.2, 0.5) for x, y in ((5, 29), (4, 35.5), (4, 42)))
        ),
    ]


def heart() -> list[Layer]:
    """A heart with a gleam."""
    half = blob("50,24! 60,11 76,8 91,18 95,38 84,62 50,93! 49,60!")
    return [ink(*both(half)), cut(stroke("16,40 16,29 22,20 31,17", 1, 4.5, 4.5, 1))]


def star() -> list[Layer]:
    """A star with five points."""
    return [ink(five_points(50, 50, 50))]


def question_mark() -> list[Layer]:
    """A question mark."""
    hook = np.concatenate([arc(50, 28, 20, 175, 410), curve("60,45.5 54,50 50.5,57 50,68")])
    return [ink(brush(hook, 15, 15, 16, 17, 17, 17, 15, 14)), ink(ellipse(50, 90, 9.5))]


def exclamation() -> list[Layer]:
    """An exclamation mark."""
    return [ink(blob("36.5,16 50,3 63.5,16 56,64! 44,64!"), ellipse(50, 86, 10.5))]


def tree() -> list[Layer]:
    """A broad-leaved tree."""
    lobes = (
        (50, 20, 17),
        (32, 28, 15),
        (68, 28, 15),
        (22, 44, 15),
        (78, 44, 15),
        (36, 52, 16),
        (64, 52, 16),
        (50, 40, 20),
    )
    return [
        ink(*(ellipse(x, y, r) for x, y, r in lobes)),
        ink(blob("45,50! 55,50! 55,78 60,90 70,96! 30,96! 40,90 45,78")),
        cut(
            stroke("50,92 50,70 50,44", 0.8, 2, 0.8),
            stroke("50,66 58,56 66,50", 1.6, 0.6),
            stroke("50,60 42,50 36,44", 1.6, 0.6),
        ),
        cut(
            stroke("50,52 56,42 60,34", 1.4, 0.5),
            stroke("22,36 28,32 33,32", 0.5, 1.6, 0.5),
            stroke("42,16 49,12 56,14", 0.5, 1.6, 0.5),
        ),
    ]


def house() -> list[Layer]:
    """A gabled house with a smoking chimney."""
    return [
        ink(rectangle(68, 14, 79, 40), polygon("50,8 97,50 92,56 50,19 8,56 3,50")),
        ink(polygon("50,22 86,54 86,94 14,94 14,54")),
        cut(rectangle(42, 66, 58, 94), rectangle(22, 60, 36, 75), rectangle(64, 60, 78, 75), ellipse(50, 43, 7)),
        ink(rectangle(28.2, 60, 29.8, 75), rectangle(22, 66.7, 36, 68.3), rectangle(70.2, 60, 71.8, 75)),
        ink(rectangle(64, 66.7, 78, 68.3), rectangle(49.2, 36, 50.8, 50), rectangle(43, 42.2, 57, 43.8)),
        ink(rectangle(44, 68, 56, 94)),
        cut(ellipse(53, 81, 1.5)),
    ]


def sun() -> list[Layer]:
    """A smiling disc with twelve rays."""
    ray = blob("50,3! 56,20 55,25! 45,25! 44,20")
    return [
        ink(*(turned(ray, 30 * k) for k in range(12))),
        ink(ellipse(50, 50, 22)),
        cut(*both(ellipse(42.5, 45, 2.6, 3.6)), stroke("39,55 44,60.5 50,62 56,60.5 61,55", 1, 2.6, 2.6, 1)),
    ]


def moon() -> list[Layer]:
    """A crescent with two stars."""
    crescent = np.concatenate([arc(48, 50, 44, 27.3, 279.6), arc(66, 41, 36, 252.8, 54.1)])
    return [ink(crescent, five_points(66, 36, 13), five_points(82, 58, 8))]


def fish() -> list[Layer]:
    """A fish that swims to the left."""
    scales = [
        stroke(f"{x + 4},{y - 5} {x},{y} {x + 4},{y + 5}", 0.5, 1.4, 0.5)
        for x, rows in ((40, (44, 56)), (48, (38, 50, 62)), (56, (44, 56)), (64, (50,)))
        for y in rows
    ]
    return [
        ink(blob("38,30! 46,18 60,14 68,16! 64,24 68,36!"), blob("46,70! 50,80 60,85! 60,76 62,68!")),
        ink(blob("3,52 14,38 32,28 52,29 70,40 79,46! 97,26! 93,50 97,75! 79,55! 68,63 50,72 30,72 13,64")),
        cut(ellipse(18, 46, 4)),
        ink(ellipse(17.4, 46.4, 2)),
        cut(stroke("29,32 34,50 28,68", 0.8, 2.2, 0.8), stroke("4,56 10,57 15,54", 1.4, 0.5), *scales),
        cut(*(stroke(f"82,{50 + s * 0.6:g} 88,{50 + s * 5} 93,{50 + s * 10}", 1.2, 0.8) for s in (-1.6, 0, 1.6))),
    ]


def key() -> list[Layer]:
    """An old key, upright."""
    bit = polygon("52,72 66,72 66,77 75,77 75,92 67,92 67,85 61,85 61,92 52,92")
    return [
        ink(*(ellipse(x, y, 14) for x, y in ((50, 17), (36, 32), (64, 32)))),
        ink(rectangle(45, 20, 55, 96), rectangle(40, 50, 60, 55), ellipse(50, 96, 5), bit),
        cut(*(ellipse(x, y, 7) for x, y in ((50, 17), (36, 32), (64, 32)))),
    ]


def anchor() -> list[Layer]:
    """An anchor with a ring."""
    arm = np.concatenate([arc(50, 50, 44, 90, 15), arc(50, 40, 43, 15, 90)])
    fluke = polygon("95,36 101,68 91,61 77,65")
    return [
        ink(ellipse(50, 13, 10)),
        cut(ellipse(50, 13, 5)),
        ink(polygon("46.5,21 53.5,21 56,90 44,90"), rectangle(30, 27, 70, 34), *both(ellipse(30, 30.5, 5), arm, fluke)),
    ]
