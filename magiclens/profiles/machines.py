"""Machines: what they can make, and what suits a lens for them unless a spec says otherwise."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from magiclens.contract.artifacts import FloatArray, Lens
from magiclens.contract.units import ANGLE, LENGTH, Angle, Length
from magiclens.processes.curing import Cure
from magiclens.processes.layers import WHOLE_LAYERS, Grey, Slicing
from magiclens.processes.linear import LinearProcess
from magiclens.processes.tilting import Tilt
from magiclens.profiles.data import read_data

_REFUSED = "refused"
"""The key of entries that only say why a machine cannot make lenses."""
_USUAL_FACETS = 32
"""Facets along a side that show what most pictures have."""
_SAFELY = 1.5
"""How much larger than the smallest feature facets are chosen."""
_STRIPS = 9
"""Facets are so many times as wide as the rounded strips between them: at 100 mm this was best, or within 0.1 dB of the
best, for a stereolithography printer, polished or under a coat of 20 micrometres."""
_SPEED = r"^\d+(\.\d+)? ?mm/(min|s)$"
"""Pattern of the text of a speed."""
_Side = Annotated[Length, Field(ge=1, le=1e5)]
"""Of the room that a machine has."""
_Dots = Annotated[float, Field(ge=1, le=1e5)]
"""Pixels or drops per inch."""
_LONGEST_WAVE_MM = 50.0
"""Longest wave that a coat may level; see ``LinearProcess``."""


class Machine(BaseModel, ABC):
    """What a machine can do. The fields are the keys that a spec may write beside ``fabrication.machine``.

    Lengths are mm and angles degrees.

    Attributes:
        process: The name of the process in data files: ``printing`` or ``milling``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)
    process: ClassVar[str]

    bed: tuple[_Side, _Side, _Side] = Field(description="largest block: width, depth, height")
    thickness: tuple[Length, Length] = Field(description="thinnest place and highest point of a lens that it makes")
    # the limits of what a lens may have
    max_slope: Angle = Field(ge=0.1, lt=90, description="steepest facet")
    wall: Length = Field(ge=1e-5, le=10, description="narrowest strip between two facets")
    feature: Length = Field(ge=1e-3, le=2000, description="smallest facet that keeps its shape")
    roughness: float = Field(0.0, ge=0, le=1, description="GGX alpha of the surface, finished")
    price: float | None = Field(
        None, ge=0, le=1e6, description="EUR per kg of material; the material's estimate if left out"
    )

    @field_validator("thickness")
    @classmethod
    def _is_a_range(cls, value: tuple[float, float]) -> tuple[float, float]:
        least, most = value
        if not 0 < least < most:
            raise ValueError(f"goes from thin to thick, such as [{LENGTH.text(most)}, {LENGTH.text(least)}]")
        return value

    @property
    def limits(self) -> dict[str, str]:
        """Keys under ``lens`` that are set to the machine's limit unless the spec writes them, as text with units."""
        return {"wall": LENGTH.text(self.wall), "max_slope": ANGLE.text(self.max_slope)}

    @abstractmethod
    def integrator(self, wall_mm: float, cells: str) -> dict[str, Any]:
        """Options of the integrator that suit this machine, as a spec writes them.

        Args:
            wall_mm: Width of the walls between facets.
            cells: What facets are cut along, see ``Lens``.
        """

    def has_room_for(self, sides_mm: FloatArray) -> bool:
        """Whether a part fits, turned by a quarter if need be: its width, depth and height as it stands, mm."""
        bed = np.array(self.bed)
        flat = np.sort(sides_mm[:2]) <= np.sort(bed[:2])
        return bool(flat.all() and sides_mm[2] <= bed[2])

    def facets_for(self, size_mm: float) -> int:
        """How many facets along a side suit this machine: what ``lens.facets: auto`` stands for."""
        return min(max(int(size_mm / (_SAFELY * self.feature)), 1), _USUAL_FACETS)

    def rim_mm(self, lens: Lens, distance_mm: float) -> float:
        """How far the top must go on beyond the lens's square, so that its rim shows no frame.

        Args:
            lens: The lens.
            distance_mm: From the reference plane to the eye.
        """
        return 0.0

    @abstractmethod
    def exporters(self) -> dict[str, dict[str, Any]]:
        """Options that suit this machine, as a spec writes them, by type of exporter."""


class Lacquer(BaseModel):
    """A coat that levels before it cures.

    Attributes:
        wavelength_mm: Of a wave of this wavelength the coat leaves 1/e (Orchard's equation, see ``LinearProcess``).
    """

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    film: Length | None = Field(None, ge=1e-4, le=1, description="thickness of the coat while it is liquid")
    wavelength: Length | None = Field(
        None,
        ge=1e-3,
        le=_LONGEST_WAVE_MM,
        description="instead of film: the wavelength of which the coat leaves 1/e, as a coupon measures it",
    )
    viscosity: float = Field(1.0, ge=1e-4, le=1e4, description="Pa s")
    tension: float = Field(0.033, ge=1e-3, le=1, description="surface tension, N/m")
    time: float = Field(10.0, ge=1e-3, le=1e5, description="seconds until it has cured")

    @model_validator(mode="after")
    def _film_or_wavelength(self) -> Lacquer:
        if (self.film is None) == (self.wavelength is None):
            raise ValueError("needs either a film, such as 'film: 5um', or a wavelength, such as 'wavelength: 0.4mm'")
        return self

    @model_validator(mode="after")
    def _leaves_a_lens(self) -> Lacquer:
        if self.wavelength_mm > _LONGEST_WAVE_MM:
            levels = f"such a coat would level waves of {LENGTH.text(round(self.wavelength_mm, 1))}"
            raise ValueError(f"{levels}, and nothing would be left of a lens; use a thinner film")
        return self

    @property
    def wavelength_mm(self) -> float:
        """See ``Lacquer``."""
        if self.film is None:
            return self.wavelength or 0.0
        film_m = self.film / 1000
        fourth_power: float = self.time * self.tension * film_m**3 / (3 * self.viscosity)
        return 1000 * 2 * math.pi * math.sqrt(math.sqrt(fourth_power))


class Printer(Machine):
    """A machine that builds layer on layer.

    Attributes:
        process: See ``Machine``.
        shares: (L,) of a layer's height that the top of a column may have, see ``Grey``. Slicers that round plainly
            make whole layers only: their grey is for edges.
        linear_process: What spreading and the finish leave of the surface.
    """

    process: ClassVar[str] = "printing"

    dpi: tuple[_Dots, _Dots] = Field(description="drops or pixels per inch along x and y")
    layer: Length = Field(ge=1e-4, le=1, description="height of a layer")
    blur: Length = Field(ge=0, le=2, description="how far material spreads sideways: sigma of a Gaussian")
    polish: Length = Field(
        "0mm", validate_default=True, ge=0, le=5,
        description="how far polishing evens the surface out: sigma of a Gaussian; 0mm leaves it raw",
    )  # fmt: skip
    lacquer: Lacquer | None = Field(None, description="a liquid coat, which levels what lies beneath")
    slicing: Slicing = Field(
        "plain", description="how heights become layers: plain rounding, as slicers do it, or error diffusion"
    )
    grey: Grey | None = Field(None, description="pixels that are exposed in steps; black and white only if left out")
    cure: Cure | None = Field(None, description="how deep its light cures the resin")
    tilt: Tilt | None = Field(None, description="how the part stands on the plate; flat on it if left out")

    @property
    def pixels_mm(self) -> tuple[float, float]:
        """Width and height of a pixel, mm."""
        return 25.4 / self.dpi[0], 25.4 / self.dpi[1]

    @property
    def shares(self) -> FloatArray:
        """See ``Printer``."""
        return self.grey.shares if self.grey and self.slicing == "diffused" else WHOLE_LAYERS

    @property
    def linear_process(self) -> LinearProcess:
        """See ``Printer``."""
        # two Gaussians in a row are one whose variance is the sum of theirs
        return _linear(math.hypot(self.blur, self.polish), self.lacquer)

    @property
    def spreading(self) -> LinearProcess:
        """What the machine itself leaves of a surface, without the finish."""
        return _linear(self.blur)

    @property
    def finish(self) -> LinearProcess:
        """What the finish alone leaves of a surface."""
        return _linear(self.polish, self.lacquer)

    @property
    def growth_mm(self) -> float:
        """How much thicker a tilted part becomes, since light cures resin below its flat side, see ``Cure``.

        That side is where supports stand, too; it is sanded flat or lies on its sheet, where light hardly bends any
        more. A part that lies flat on the plate has no resin below it.
        """
        if self.cure is None or self.tilt is None:
            return 0.0
        return self.cure.below_mm(self.layer) * math.cos(math.radians(self.tilt.angle))

    def integrator(self, wall_mm: float, cells: str) -> dict[str, Any]:
        """The process, through which a top of vertical cells is refined as one surface."""
        return {"process": self.linear_process.model_dump(mode="json")} if cells == "vertical" else {}

    def rim_mm(self, lens: Lens, distance_mm: float) -> float:
        """How far the body's edge is rounded off, and how far the eye looks past the edge of facets that are low."""
        return self.linear_process.reach_mm + lens.relief_mm * lens.size_mm / 2 / distance_mm

    def facets_for(self, size_mm: float) -> int:
        """So many that the rounded strips between them take a fifth of the lens, see ``LinearProcess.strip_mm``."""
        pitch = max(_STRIPS * self.linear_process.strip_mm, _SAFELY * self.feature)
        return min(max(round(size_mm / pitch), 1), 2 * _USUAL_FACETS)

    def exporters(self) -> dict[str, dict[str, Any]]:
        """Options for slices at the machine's own resolution."""
        slices: dict[str, Any] = {"dpi_x": self.dpi[0], "dpi_y": self.dpi[1], "layer": LENGTH.text(self.layer)}
        slices |= {"slicing": self.slicing, "process": self.linear_process.model_dump(mode="json")}
        for key, part in (("grey", self.grey), ("tilt", self.tilt)):
            if part:
                slices[key] = part.model_dump(mode="json")
        return {"slices": slices, "sl1": {**slices, "bed": [LENGTH.text(side) for side in self.bed]}}


def _linear(spread: float, lacquer: Lacquer | None = None) -> LinearProcess:
    levelling = lacquer.wavelength_mm if lacquer else 0.0
    return LinearProcess(spread=LENGTH.text(round(spread, 6)), levelling=LENGTH.text(round(levelling, 6)))


class Mill(Machine):
    """A machine with three axes that cuts with a rotating tool from above."""

    process: ClassVar[str] = "milling"

    draft: Angle = Field(ge=0, lt=90, description="least angle between a wall and the tool's axis")
    cutter: Literal["ball", "flat", "v"] = Field(description="form of the finishing cutter's end")
    # the limits of ``Cutter`` and of programs
    diameter: Length = Field(ge=0.001, le=50, description="of the cutter's widest part")
    tip: Length = Field("0.2mm", validate_default=True, ge=0, le=50, description="diameter of a v cutter's tip")
    angle: Angle = Field("30deg", validate_default=True, ge=5, le=170, description="between a v cutter's flanks")
    reach: Length = Field(ge=0.01, le=1000, description="how deep it gets into a narrow hole before its holder touches")
    stepover: Length = Field(
        "0.02mm", validate_default=True, ge=0.001, le=5,
        description="between the lines of finishing; polishing their ridges away evens out over half of it",
    )  # fmt: skip
    spindle: int = Field(12000, ge=1, le=1_000_000, description="turns per minute")
    feed: str = Field("1200mm/min", pattern=_SPEED, description="while cutting")
    plunge: str = Field("300mm/min", pattern=_SPEED, description="straight down")

    @property
    def limits(self) -> dict[str, str]:
        """Those of every machine, and what the flank of the cutter and its reach allow."""
        # the top may be twice the relief deep; a hundredth is left so that rounding does not reach the limit
        steepest = ANGLE.text(min(self.max_slope, self.steepest_deg))
        return {**super().limits, "max_slope": steepest, "relief": LENGTH.text(min(0.495 * self.reach, 9.9))}

    @property
    def steepest_deg(self) -> float:
        """The steepest surface that the cutter's flank touches without cutting into it, degrees from the bed."""
        return 90.0 - (self.angle / 2 if self.cutter == "v" else self.draft)

    def integrator(self, wall_mm: float, cells: str) -> dict[str, Any]:
        """The step limit that follows from the walls."""
        return {"step_limit": LENGTH.text(round(self.step_mm(wall_mm), 4))}

    def step_mm(self, wall_mm: float) -> float:
        """The highest step between facets, mm, at which a wall of this width still leans by the machine's draft."""
        # a draft of 0 would allow any step; a tenth of a degree keeps the number finite
        return wall_mm / math.tan(math.radians(max(self.draft, 0.1)))

    @property
    def polish_mm(self) -> float:
        """Sigma, mm, of the Gaussian that stands for polishing: it leaves less than 1 % of the ridges between lines."""
        # a Gaussian leaves exp(-2 (pi sigma / period)^2) of a wave, here 0.7 %
        return self.stepover / 2

    @property
    def tool(self) -> dict[str, str]:
        """The finishing cutter, as a spec writes it."""
        end = {"tip": LENGTH.text(self.tip), "angle": ANGLE.text(self.angle)} if self.cutter == "v" else {}
        return {
            "shape": self.cutter, "diameter": LENGTH.text(self.diameter), **end, "reach": LENGTH.text(self.reach)
        }  # fmt: skip

    def exporters(self) -> dict[str, dict[str, Any]]:
        """Options for programs: the cutter, its speeds and the machine's travel."""
        options = {
            "cutter": self.tool,
            "stepover": LENGTH.text(self.stepover),
            "bed": [LENGTH.text(side) for side in self.bed[:2]],
            "spindle": self.spindle,
            "feed": self.feed,
            "plunge": self.plunge,
        }
        return {"gcode": options, "rml": options}


PROCESSES: Mapping[str, type[Machine]] = MappingProxyType({cls.process: cls for cls in (Printer, Mill)})
"""The class of machines of each process."""


class Profile(BaseModel):
    """One entry of ``machines.yaml``.

    ``options`` are the fields of the machine; ``lens`` and ``stages`` are what a spec may write under ``lens`` and
    ``pipeline``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str = Field(min_length=1, description="what it is, in words")
    process: Literal["printing", "milling"]
    source: str = Field(min_length=1, description="where the numbers come from")
    files: list[str] = Field([], description="exporters whose files it, or the program that comes with it, reads")
    options: dict[str, Any]
    lens: dict[str, Any] = Field({}, description="spec keys under lens, where the spec does not write them")
    stages: dict[str, dict[str, Any]] = Field({}, description="options of stages that suit it, by kind")

    @property
    def model(self) -> type[Machine]:
        """The class of this machine."""
        return PROCESSES[self.process]

    @property
    def exporters(self) -> list[dict[str, Any]]:
        """The files of specs that name none: STL, which any program reads, the machine's own, and the sheet."""
        return [{"type": name} for name in dict.fromkeys(("stl", *self.files, "sheet"))]

    def machine(self) -> Machine:
        """The machine with the options of the data file."""
        return self.model.model_validate(self.options)


@cache
def machines() -> Mapping[str, Profile]:
    """Every machine by its name in specs."""
    entries = read_data("machines.yaml").items()
    return MappingProxyType({name: Profile.model_validate(entry) for name, entry in entries if _REFUSED not in entry})


@cache
def refused_machines() -> Mapping[str, str]:
    """Why some machines cannot make lenses, by their names."""
    entries = read_data("machines.yaml").items()
    return MappingProxyType({name: entry[_REFUSED].strip() for name, entry in entries if _REFUSED in entry})
