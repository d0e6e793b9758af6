"""What a new spec says for each scenario, line by line; lines that start with ``#`` become comments."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from magiclens.contract.units import LENGTH
from magiclens.new.assess import Assessment
from magiclens.profiles.machines import Printer, machines

Place = Literal["table", "hand", "wall"]
"""Where the lens is used: laid down and looked at from a fixed place, held in a hand, or hung up for people passing."""

_DISTANCES: dict[Place, str] = {"table": "400mm", "hand": "400mm", "wall": "1500mm"}
"""Usual distances from the lens to the eye."""

_LAYERED = {"slices", "sl1"}
"""Exporters of layers."""
_STEADY = 2
"""How many times wider facets are in a hand or on a wall, where things lie a millimetre off."""


@dataclass(frozen=True)
class Request:
    """What a user wants a spec for.

    Attributes:
        pictures: What the lens shall show: paths as the spec writes them, and what was found in each picture.
        source: Path of the user's own source; None for discs.
        questions: The user's questions, one per picture or none.
        inks: What the pictures' own colours are, for discs; nothing for black and white.
        machine: Name of the machine that makes the lens; None if it is left open.
        size_mm: Side of the lens.
        place: Where it is used.
        facets: How many along a side, if the user has said so.
        thickness: Of the lens, as a spec writes it, if the user has said so.
        paper: Of the sheet to print.
        jig: Whether to write a jig, too.
    """

    pictures: Sequence[tuple[str, Assessment]]
    source: str | None = None
    questions: Sequence[str] = ()
    inks: Sequence[str] = ()
    machine: str | None = None
    size_mm: float = 100.0
    place: Place = "table"
    facets: int | None = None
    thickness: str | None = None
    paper: str = "auto"
    jig: bool = False

    @property
    def viewer(self) -> str:
        """The line about the viewer."""
        distance = _DISTANCES[self.place]
        return f"viewer: {{distance: {distance}}}".ljust(42) + "# from the lens to the eye, straight above its centre"

    @property
    def marked(self) -> bool:
        """Whether the lens tells which side is up: where it is printed from a mesh, or has a jig to fit.

        A mark that tapers makes every layer another one, and an archive of layers takes several times as long.
        """
        if self.machine is None:
            return self.jig
        profile = machines()[self.machine]
        printed = isinstance(profile.machine(), Printer)
        return printed and (self.jig or not _LAYERED & {*profile.files})

    def steady(self, facets: int, why: str) -> tuple[int, str]:
        """How many facets, and why, where the lens is used."""
        if self.place == "table":
            return facets, why
        fewer = max(facets // _STEADY, min(facets, _LEAST_FACETS))
        return fewer, (
            f"{fewer} x {fewer} wide facets for the {self.place}: the sheet may lie about twice as far off as with "
            f"{facets} x {facets}, and the picture is coarser. The report says how far, and what it looks like."
        )

    def wider(self, factor: float) -> str:
        """So many times the lens's side, as a spec writes it."""
        return LENGTH.text(round(factor * self.size_mm, 6))

    @property
    def fine(self) -> list[str]:
        """Names of the pictures that need many facets."""
        return [assessment.path.name for _, assessment in self.pictures if assessment.fine]


_LEAST_FACETS = 8
"""With fewer facets along a side, no picture is left."""


@dataclass(frozen=True)
class Layout:
    """How a spec of one scenario is written.

    Attributes:
        title: What the lens does, for the first comment.
        least: Least number of pictures.
        most: Largest number of pictures.
        scenario: The lines below the key ``scenario``, without its type.
        lens: The lines below the key ``lens``.
        pipeline: The lines below the key ``pipeline``.
        source: Whether the user may give a source.
        questions: Whether the user may give questions.
        moving: Whether a picture may have several frames.
    """

    title: str
    least: int
    most: int
    scenario: Callable[[Request], list[str]]
    lens: Callable[[Request], list[str]]
    pipeline: Callable[[Request], list[str]]
    source: bool = True
    questions: bool = False
    moving: bool = False


def _target_options(assessment: Assessment) -> str:
    """The keys of a target besides its file."""
    crop = ", fit: crop" if assessment.crop else ""
    percents = ", ".join(f"{100 * level:.0f}%" for level in assessment.levels or ())
    levels = f", levels: [{percents}]" if percents else ""
    negative = ", invert: true" if assessment.invert else ""
    return f"{crop}{levels}{negative}"


def _target(path: str, assessment: Assessment) -> str:
    return f"{{image: {path}{_target_options(assessment)}}}"


def _reasons(assessment: Assessment) -> str:
    return f"# {' '.join(assessment.reasons)}"


def _source(request: Request, size: str = "", seed: int = 7) -> list[str]:
    """The source, and why it is this one."""
    sized = f", size: {size}" if size else ""
    if request.source:
        return ["# Print this; the more black and white it has everywhere, the better the lens.",
                f"source: {{type: image, path: {request.source}{sized}}}"]  # fmt: skip
    why = "in the pictures' own colours" if request.inks else "black and white"
    comment = (
        f"# Random discs, {why}: something of every shape is near every facet. Or {{type: image, path: dots.png}}."
    )
    if request.inks:
        inks = ", ".join(map(repr, request.inks))
        return [comment, f"source: {{type: circles, seed: {seed}{sized},", f"         colours: [{inks}]}}"]
    return [comment, f"source: {{type: circles, seed: {seed}{sized}}}"]


def _one_target(request: Request, size: str = "") -> list[str]:
    path, assessment = request.pictures[0]
    return [*_source(request, size), _reasons(assessment), f"target: {_target(path, assessment)}"]


def _single(request: Request) -> list[str]:
    return _one_target(request)


def _rotating(request: Request) -> list[str]:
    targets = []
    for path, assessment in request.pictures:
        targets += [f"  {_reasons(assessment)}", f"  - {_target(path, assessment)}"]
    angles = ", ".join(f"{90 * k}deg" for k in range(len(request.pictures)))
    return [
        *_source(request),
        "targets:",
        *targets,
        f"angles: [{angles}]   # counter-clockwise as the viewer sees it",
    ]


def _multi_pair(request: Request) -> list[str]:
    lines = ["# Every picture has a source of its own, made of discs.", "pairs:"]
    for k, (path, assessment) in enumerate(request.pictures):
        first, *more = _source(request, seed=7 + k)[1:]
        lines += [f"  {_reasons(assessment)}", f"  - {first}", *(f"    {line}" for line in more)]
        lines += [f"    target: {_target(path, assessment)}"]
    return lines


def _multi_view(request: Request) -> list[str]:
    # refraction takes an eye tilted by 15 deg sin(15 deg) / 1.49 * 40 mm = 7 mm past the edge; the window needs more
    lines = [
        *_source(request, request.wider(1.2)),
        "# The source is larger than the lens, since tilted eyes look past its edge. Azimuth 0deg is to the right.",
        "views:",
    ]
    for k, (path, assessment) in enumerate(request.pictures):
        azimuth = round((180 + 360 * k / len(request.pictures)) % 360)
        eye = f"{{tilt: 15deg, azimuth: {azimuth}deg}}"
        lines += [f"  {_reasons(assessment)}", f"  - {{target: {_target(path, assessment)}, eye: {eye}}}"]
    return lines


def _stable_zone(request: Request) -> list[str]:
    return [*_one_target(request, request.wider(1.04)), "cone: 1.15deg   # apex of the cone in which the picture stays"]


def _animation(request: Request) -> list[str]:
    frames = ", ".join(path for path, _ in request.pictures)
    crop = ", fit: crop" if any(assessment.crop for _, assessment in request.pictures) else ""
    painted = [f"source: {{type: image, path: {request.source}}}   # what is painted on"] if request.source else []
    return [
        "# Every frame is painted into a source of its own, whatever its tones: nothing needs to be inverted.",
        f"frames: {{images: [{frames}]{crop}}}",
        *painted,
        "fps: 8",
        "subdivisions: 2   # each patch of the source is cut into 2 x 2 sub-regions, one for a facet",
        "camouflage: {type: texture}   # what covers regions that no facet shows",
    ]


def _questions(request: Request) -> list[str]:
    count = len(request.pictures)
    usual = [f"What is picture {k + 1}?" for k in range(count)] if count > 1 else ["What is this?"]
    lines = ["lens: universal   # the answers are painted around the questions, which stay as they are", "pairs:"]
    for (path, assessment), question in zip(request.pictures, request.questions or usual, strict=True):
        text = json.dumps(question, ensure_ascii=False)
        lines += [
            f"  {_reasons(assessment)}",
            f"  - question: {{type: text, text: {text}, box: [5%, 46%, 95%, 54%]}}",
            f"    answer: {_target(path, assessment)}",
        ]
    return [*lines, "margin: 1.5mm   # kept free around the questions", "camouflage: {type: texture}"]


def _lens(request: Request, facets: int, microfacets: int, why: str) -> list[str]:
    return _lens_lines(request, *request.steady(facets, why), microfacets)


def _lens_lines(request: Request, facets: int | str, why: str, microfacets: int) -> list[str]:
    # the machine's own material and thickness, where one is named
    usual = [] if request.machine else ["thickness: 40mm   # thicker lenses reach further with flatter facets"]
    if request.thickness:
        usual = [f"thickness: {request.thickness}"]
    if request.facets:
        facets, why = request.facets, f"{request.facets} x {request.facets} facets, as was wished."
    material = [] if request.machine else ["material: acrylic"]
    mark = ["mark: true   # at the foot of the side that is up"] if request.marked else []
    return [
        f"size: {request.wider(1)}",
        f"# {why}",
        f"facets: {facets}",
        f"microfacets: {microfacets}   # flat cells along a facet's side; more of them are smoother and take longer",
        *usual,
        "gap: 0mm   # the lens lies on the source",
        *material,
        *mark,
    ]


def _matched_lens(request: Request) -> list[str]:
    if request.machine:
        why = f"As many as suit {request.machine}, which rounds the borders of facets: 'mlens plan' says how many."
        if request.place == "table":
            return _lens_lines(request, "auto", why, 22)
        return _lens(request, machines()[request.machine].machine().facets_for(request.size_mm), 22, why)
    if request.fine:
        names = " and ".join(request.fine[:2])
        return _lens(
            request, 64, 16, f"64 x 64 facets: {names} would lose detail in 32 x 32, which are 4 times quicker."
        )
    why = "32 x 32 facets are enough for bold drawings; 64 show finer strokes and take longer."
    return _lens(request, 32, 22, why)


def _stable_zone_lens(request: Request) -> list[str]:
    if request.machine:
        return _matched_lens(request)
    why = "Nine eyes share every facet: many small ones keep the picture. 128 are better, and slow."
    return _lens(request, 64, 11, why)


def _universal_lens(request: Request) -> list[str]:
    why = "Each facet shows a patch as fine as it is painted, so that a few large facets are best."
    return _lens(request, 16, 64, why)


def _pipeline(request: Request, *matching: str) -> list[str]:
    return [
        *matching,
        *_exporters(request),
        "renderers: [{type: tracer}]   # and {type: mitsuba}, which traces the exported mesh independently",
    ]


def _exporters(request: Request) -> list[str]:
    """What the machine reads, or where none is named what most programs read; and the source, to print."""
    named = machines()[request.machine].files if request.machine else ("3mf", "stl")
    why = (
        f"What {request.machine} reads"
        if request.machine
        else "The lens for slicers (3mf), the same for other programs (stl, which is larger)"
    )
    paper = "" if request.paper == "auto" else f", paper: {request.paper}"
    files = [f"{{type: {name}}}" for name in named]
    files += [f"{{type: sheet{paper}}}", *(["{type: jig}"] if request.jig else [])]
    return [f"# {why}, and the source to print (sheet); see 'mlens plugins'.", f"exporters: [{', '.join(files)}]"]


def _one_target_pipeline(request: Request) -> list[str]:
    return _pipeline(
        request,
        "# A tenth of the source's width is enough to choose from for one picture; more makes facets steeper.",
        "matcher: {type: exhaustive, window: 10%}",
    )


def _several_targets_pipeline(request: Request) -> list[str]:
    count = len(request.pictures)
    if count == 1:
        return _one_target_pipeline(request)
    return _pipeline(
        request,
        f"# One patch must suit {count} pictures: in twice the usual window are four times as many to choose from.",
        "matcher: {type: exhaustive, window: 20%}",
    )


def _tilted_eyes_pipeline(request: Request) -> list[str]:
    return _pipeline(
        request,
        "# Facets are matched again at the heights they get, as these move them in the pictures of tilted eyes.",
        "rematch: 2",
        "matcher: {type: multi-view}",
    )


def _stable_zone_pipeline(request: Request) -> list[str]:
    return _pipeline(
        request,
        "# Small maps keep plain areas plain while the eye moves, large ones keep edges in position.",
        "matcher: {type: multi-view, scales: [0.15, 2.5], step: 0.3mm, pixels: 4, candidates: 49, polish: 12}",
    )


def _universal_pipeline(request: Request) -> list[str]:
    return _pipeline(
        request, "# The usual matcher here draws a sub-region for every facet; the encoder paints the sources."
    )


def _question_pipeline(request: Request) -> list[str]:
    return _pipeline(
        request,
        "# Facets over the question show patches beside it, so they reach further than usual.",
        "matcher: {type: dart-throwing, reach: 8%}",
    )


LAYOUTS = {
    "single": Layout(
        "One picture in one source", 1, 1,
        _single, _matched_lens, _one_target_pipeline,
    ),
    "rotating": Layout(
        "A picture at every quarter turn", 2, 4,
        _rotating, _matched_lens, _several_targets_pipeline,
    ),
    "multi-pair": Layout(
        "A picture over each of several sources", 1, 8,
        _multi_pair, _matched_lens, _several_targets_pipeline,
        source=False,
    ),
    "multi-view": Layout(
        "Another picture for each eye", 1, 16,
        _multi_view, _matched_lens, _tilted_eyes_pipeline,
    ),
    "stable-zone": Layout(
        "A picture that stays while the eye moves", 1, 1,
        _stable_zone, _stable_zone_lens, _stable_zone_pipeline,
    ),
    "universal-animation": Layout(
        "A lens for any picture, here for some frames", 1, 64,
        _animation, _universal_lens, _universal_pipeline,
        moving=True,
    ),
    "question-answer": Layout(
        "Questions that turn into pictures", 1, 16,
        _questions, _universal_lens, _question_pipeline,
        source=False, questions=True,
    ),
}  # fmt: skip
"""Layouts by type of scenario."""

ON_MACHINES = {
    "milled": ("single", "egx-600"),
    "printed-single": ("single", "sla"),
    "printed-lcd": ("single", "lcd-12k"),
    "printed-rotating": ("rotating", "sla"),
    "printed-universal": ("universal-animation", "sla"),
    "question-answer-universal": ("question-answer", None),
}
"""Scenario and machine of shipped specs that are called otherwise than their scenario."""

SPECIAL = {
    "fine-detail": "single",
    "rotating-codesign": "rotating",
    "question-answer-source-optimized": "question-answer",
}
"""The scenario of shipped specs whose special options ``mlens new`` does not write."""
