"""What a new spec says for each scenario, line by line, and why. Lines that start with ``#`` become comments."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from magiclens.new.judge import Judgement

Lines = list[str]


@dataclass(frozen=True)
class Order:
    """Pictures, each as the spec writes its path and with what was found in it; the user's source; questions."""

    pictures: Sequence[tuple[str, Judgement]]
    source: str | None = None
    questions: Sequence[str] = ()

    @property
    def coloured(self) -> bool:
        """Whether some picture has colours."""
        return any(judged.coloured for _, judged in self.pictures)

    @property
    def fine(self) -> list[str]:
        """Pictures that need many facets, by name."""
        return [judged.path.name for _, judged in self.pictures if judged.fine]


@dataclass(frozen=True)
class Layout:
    """How many pictures a scenario takes, whether a source and questions, and what its spec says."""

    title: str
    least: int
    most: int
    scenario: Callable[[Order], Lines]
    lens: Callable[[Order], Lines]
    pipeline: Callable[[Order], Lines]
    source: bool = True
    questions: bool = False


def _look(judged: Judgement, inverts: bool = True) -> str:
    """The keys of a target besides its file."""
    levels = f", levels: [{', '.join(f'{100 * level:.0f}%' for level in judged.levels)}]" if judged.levels else ""
    negative = ", invert: true" if judged.invert and inverts else ""
    return f"{', fit: crop' if judged.crop else ''}{levels}{negative}"


def _target(path: str, judged: Judgement) -> str:
    return f"{{image: {path}{_look(judged)}}}"


def _reasons(judged: Judgement) -> str:
    return f"# {' '.join(judged.reasons)}"


def _source(order: Order, size: str = "", seed: int = 7) -> Lines:
    """What lies below the lens."""
    sized = f", size: {size}" if size else ""
    if order.source:
        return ["# Print this; the more black and white it has everywhere, the better the lens.",
                f"source: {{type: image, path: {order.source}{sized}}}"]  # fmt: skip
    colours = ", colours: coloured" if order.coloured else ""
    why = "in colours, as a picture has some" if order.coloured else "black and white"
    return [f"# Random discs, {why}: something of every shape is near every facet. Or {{type: image, path: dots.png}}.",
            f"source: {{type: circles, seed: {seed}{colours}{sized}}}"]  # fmt: skip


def _one_target(order: Order, size: str = "") -> Lines:
    path, judged = order.pictures[0]
    return [*_source(order, size), _reasons(judged), f"target: {_target(path, judged)}"]


def _single(order: Order) -> Lines:
    return _one_target(order)


def _rotating(order: Order) -> Lines:
    targets = []
    for path, judged in order.pictures:
        targets += [f"  {_reasons(judged)}", f"  - {_target(path, judged)}"]
    angles = ", ".join(f"{90 * k}deg" for k in range(len(order.pictures)))
    return [
        *_source(order),
        "targets:",
        *targets,
        f"angles: [{angles}]   # counter-clockwise as the viewer sees it",
    ]


def _multi_pair(order: Order) -> Lines:
    lines = ["# Every picture has a sheet of discs of its own.", "pairs:"]
    for k, (path, judged) in enumerate(order.pictures):
        source = _source(order, seed=7 + k)[1].removeprefix("source: ")
        lines += [f"  {_reasons(judged)}", f"  - {{source: {source}, target: {_target(path, judged)}}}"]
    return lines


def _multi_view(order: Order) -> Lines:
    lines = [
        *_source(order, "120mm"),
        "# The source is larger than the lens, since tilted eyes look past its edge. Azimuth 0deg is to the right.",
        "views:",
    ]
    for k, (path, judged) in enumerate(order.pictures):
        azimuth = round((180 + 360 * k / len(order.pictures)) % 360)
        eye = f"{{tilt: 15deg, azimuth: {azimuth}deg}}"
        lines += [f"  {_reasons(judged)}", f"  - {{target: {_target(path, judged)}, eye: {eye}}}"]
    return lines


def _stable_zone(order: Order) -> Lines:
    return [*_one_target(order, "104mm"), "cone: 1.15deg   # apex of the cone in which the picture stays"]


def _animation(order: Order) -> Lines:
    frames = ", ".join(path for path, _ in order.pictures)
    crop = ", fit: crop" if any(judged.crop for _, judged in order.pictures) else ""
    painted = [f"source: {{type: image, path: {order.source}}}   # what is painted on"] if order.source else []
    return [
        "# Every frame is painted into a sheet of its own, whatever its tones: nothing needs to be inverted.",
        f"frames: {{images: [{frames}]{crop}}}",
        *painted,
        "fps: 8",
        "subdivisions: 2   # each patch of the source is cut into 2 x 2 places, one for a facet",
        "camouflage: {type: texture}   # what covers places that no facet sees",
    ]


def _questions(order: Order) -> Lines:
    count = len(order.pictures)
    usual = [f"What is picture {k + 1}?" for k in range(count)] if count > 1 else ["What is this?"]
    lines = ["lens: universal   # the answers are painted around the questions, which stay as they are", "pairs:"]
    for (path, judged), question in zip(order.pictures, order.questions or usual, strict=True):
        text = json.dumps(question, ensure_ascii=False)
        lines += [
            f"  {_reasons(judged)}",
            f"  - question: {{type: text, text: {text}, box: [5%, 46%, 95%, 54%]}}",
            f"    answer: {_target(path, judged)}",
        ]
    return [*lines, "margin: 1.5mm   # kept free around the questions", "camouflage: {type: texture}"]


def _slab(facets: int, microfacets: int, why: str) -> Lines:
    return [
        "size: 100mm",
        f"# {why}",
        f"facets: {facets}",
        f"microfacets: {microfacets}   # flat cells along a facet's side; more of them are smoother and take longer",
        "thickness: 40mm   # thicker slabs reach further with flatter facets",
        "gap: 0mm   # the slab lies on the source",
        "material: acrylic",
    ]


def _matched_lens(order: Order) -> Lines:
    if order.fine:
        names = " and ".join(order.fine[:2])
        return _slab(64, 16, f"64 x 64 lenslets: {names} would lose detail in 32 x 32, which are 4 times quicker.")
    return _slab(32, 22, "32 x 32 lenslets are enough for bold drawings; 64 show finer strokes and take longer.")


def _steady_lens(_: Order) -> Lines:
    return _slab(64, 11, "Nine eyes share every facet: many small ones keep the picture. 128 are better, and slow.")


def _universal_lens(_: Order) -> Lines:
    return _slab(16, 64, "Each facet shows a patch as fine as it is painted, so that a few large facets are best.")


def _made(*matching: str) -> Lines:
    return [
        *matching,
        "exporters: [{type: stl}]   # also 3mf, obj, ply, glb, sheet (the source, to print); see 'mlens plugins'",
        "renderers: [{type: tracer}]   # and {type: mitsuba}, which traces the exported mesh independently",
    ]


def _one_window(_: Order) -> Lines:
    return _made(
        "# A tenth of the source's width is enough to choose from for one picture; more makes facets steeper.",
        "matcher: {type: exhaustive, window: 10%}",
    )


def _several_window(order: Order) -> Lines:
    count = len(order.pictures)
    if count == 1:
        return _one_window(order)
    return _made(
        f"# One patch must suit {count} pictures: in twice the usual window are four times as many to choose from.",
        "matcher: {type: exhaustive, window: 20%}",
    )


def _askew(_: Order) -> Lines:
    return _made(
        "# Facets are matched again at the heights they get, as these move them in the pictures of tilted eyes.",
        "rematch: 2",
        "matcher: {type: multi-view}",
    )


def _steady(_: Order) -> Lines:
    return _made(
        "# Small maps keep plain places plain while the eye moves, large ones keep edges where they are.",
        "matcher: {type: multi-view, scales: [0.15, 2.5], step: 0.3mm, pixels: 4, candidates: 49, polish: 12}",
    )


def _painted(_: Order) -> Lines:
    return _made("# The usual matcher here draws a place of its own for every facet; the encoder paints the sheets.")


def _past_questions(_: Order) -> Lines:
    return _made(
        "# Facets over the question look past it, so they reach further than usual.",
        "matcher: {type: dart-throwing, reach: 8%}",
    )


LAYOUTS = {
    "single": Layout("One picture in one source", 1, 1, _single, _matched_lens, _one_window),
    "rotating": Layout("A picture at every quarter turn", 1, 4, _rotating, _matched_lens, _several_window),
    "multi-pair": Layout(
        "A picture over each of several sheets", 1, 8, _multi_pair, _matched_lens, _several_window, source=False
    ),
    "multi-view": Layout("Another picture for each eye", 1, 16, _multi_view, _matched_lens, _askew),
    "stable-zone": Layout("A picture that stays while the eye moves", 1, 1, _stable_zone, _steady_lens, _steady),
    "universal-animation": Layout(
        "A lens for any picture, here for some frames", 1, 64, _animation, _universal_lens, _painted
    ),
    "question-answer": Layout(
        "Questions that turn into pictures", 1, 16, _questions, _universal_lens, _past_questions,
        source=False, questions=True,
    ),
}  # fmt: skip
"""By scenario type."""
