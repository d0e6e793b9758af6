"""The models of a spec. Scenario and stages stay plain mappings, since only the registry knows which there are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, cast

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator, model_validator

from magiclens.config.optional import PYMESHLAB, is_installed
from magiclens.config.suggest import quoted, unknown
from magiclens.contract.artifacts import FloatArray, Lens
from magiclens.contract.units import FRACTION, LENGTH, Angle, Fraction, Length
from magiclens.profiles.materials import materials

DEFAULT_STAGES = {"matcher": "exhaustive", "annealer": "heat-bath", "integrator": "poisson", "finisher": "pymeshlab"}
"""The stage of each kind that runs when neither the spec nor the scenario chooses."""

FREE_FINISHER = "manifold"
"""The finisher that runs in place of the default one where pymeshlab is not installed."""

DEFAULT_ENCODER = "least-squares"
"""The encoder that runs when a spec wants one without naming it."""

AUTO = "auto"
"""What a spec writes for ``lens.facets`` to have as many as suit its machine."""

DEFAULT_SIZE = "100mm"
"""Side of a lens whose spec does not say it."""

_RELIEF_OF_FACETS = 0.6
"""Relief that facets need, relative to their side, with the usual window; wide ones need more than the usual 5 mm."""

LISTED_STAGES = {"exporters": "exporter", "renderers": "renderer"}
"""The kind of the stages at each key of the pipeline that takes several."""


class SpecModel(BaseModel):
    """Base of the models of a spec: unknown keys are errors, and values cannot be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False)


def _material_names(schema: dict[str, Any]) -> None:
    """Put the names of all materials into the JSON Schema of the field, so that editors propose them."""
    schema["anyOf"] = [{"enum": [*materials()]}, {"type": "null"}]


def _or_auto(schema: dict[str, Any]) -> None:
    """Let the JSON Schema of a number take ``auto``, too."""
    limits = {key: schema.pop(key) for key in ("type", "minimum", "maximum") if key in schema}
    schema["anyOf"] = [limits, {"const": AUTO}]


class LensSpec(SpecModel):
    """The lens: its size, its facets, its material and its limits."""

    size: Length = Field(DEFAULT_SIZE, validate_default=True, ge=1, le=2000, description="side of the square lens")
    # strict, here and below: pydantic would take the text '32' for 32, and true for 1
    facets: int = Field(
        32,
        strict=True,
        ge=1,
        le=1024,
        description="facets along one side; auto for as many as suit the machine's process",
        json_schema_extra=_or_auto,
    )
    microfacets: int = Field(22, strict=True, ge=1, le=256, description="micro-facets along one side of a facet")
    thickness: Length = Field(
        "40mm", validate_default=True, ge=0.1, le=1000, description="height of the reference plane"
    )
    gap: Length = Field(
        "0mm", validate_default=True, ge=0, le=1000, description="air between the source and the flat bottom"
    )
    material: str | None = Field(
        None,
        description="what the lens is made of; acrylic unless ior is given",
        json_schema_extra=_material_names,
    )
    ior: float | None = Field(None, gt=1, le=4, description="index of refraction, instead of a material")
    wall: Length = Field(
        "0.5um", validate_default=True, ge=1e-5, le=10, description="width of the strip between two facets"
    )
    relief: Length = Field(
        cast(Any, None),
        validate_default=True,
        ge=0.001,
        le=500,
        description="how far the top may leave the reference plane; 5mm, or more for facets wider than 8mm",
    )
    max_slope: Angle = Field("60deg", validate_default=True, ge=0.1, lt=90, description="steepest facet")
    cells: Literal["eye", "vertical"] = Field("eye", description="facets are cut along eye rays or vertically")
    mark: bool = Field(False, strict=True, description="whether a mark stands out at the foot of the side that is up")

    @field_validator("material")
    @classmethod
    def _known_material(cls, value: str | None) -> str | None:
        if value is not None and value not in materials():
            raise ValueError(unknown("material", value, materials()))
        return value

    @field_validator("ior")
    @classmethod
    def _material_or_ior(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None and info.data.get("material"):
            raise ValueError("give a material or an ior, not both")
        return value

    @field_validator("wall")
    @classmethod
    def _wall_fits(cls, value: float, info: ValidationInfo) -> float:
        # a field with a mistake is missing here; its own mistake is reported
        pitch = info.data.get("size", math.inf) / info.data.get("facets", 1)
        if value > pitch / 2:
            raise ValueError(f"the wall is wider than half a facet; at most {LENGTH.text(pitch / 2)}")
        return value

    @field_validator("facets", mode="before")
    @classmethod
    def _auto_needs_a_machine(cls, value: Any) -> Any:
        if value == AUTO:
            raise ValueError("auto needs fabrication.machine, whose process says how many suit it; 32 are usual")
        return value

    @field_validator("relief", mode="before")
    @classmethod
    def _relief_of_wide_facets(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None:
            return value
        pitch = info.data.get("size", 0.0) / info.data.get("facets", 1)
        room = info.data.get("thickness", math.inf) / 2
        return LENGTH.text(max(5.0, min(round(_RELIEF_OF_FACETS * pitch, 1), room)))

    @field_validator("relief")
    @classmethod
    def _relief_fits(cls, value: float, info: ValidationInfo) -> float:
        thickness = info.data.get("thickness", math.inf)
        if value >= thickness:
            raise ValueError(f"the relief would cut through the slab; less than {LENGTH.text(thickness)}")
        return value

    @model_validator(mode="before")
    @classmethod
    def _default_material(cls, data: Any) -> Any:
        # not the default of the field: a spec that gives an ior would then have both
        if isinstance(data, dict) and data.get("material") is None and data.get("ior") is None:
            return {**data, "material": "acrylic"}
        return data

    def build(self) -> Lens:
        """The lens, with a source of the same size; scenarios that need a larger one enlarge it."""
        ior = materials()[self.material].ior if self.material else self.ior
        return Lens(
            size_mm=self.size,
            source_size_mm=self.size,
            facets=self.facets,
            microfacets=self.microfacets,
            thickness_mm=self.thickness,
            gap_mm=self.gap,
            ior=float(ior or 0),  # the validators made sure that there is one
            wall_mm=self.wall,
            relief_mm=self.relief,
            max_slope_deg=self.max_slope,
            cells=self.cells,
            mark=self.mark,
        )


class Viewer(SpecModel):
    """Where the eye is. It is a pinhole."""

    distance: Length = Field(
        "400mm", validate_default=True, ge=1, le=1e6, description="from the reference plane to the eye"
    )
    x: Length = Field("0mm", validate_default=True, ge=-1e5, le=1e5, description="to the right of the lens's centre")
    y: Length = Field(
        "0mm", validate_default=True, ge=-1e5, le=1e5, description="above the lens's centre, as the viewer sees it"
    )

    def eye_mm(self, lens: Lens) -> FloatArray:
        """Position of the eye: (3,) float64, mm, world frame."""
        return np.array([self.x, self.y, lens.thickness_mm + self.distance])


def _choice(value: object) -> object:
    if not isinstance(value, dict):
        example = value if isinstance(value, str) else "name"
        raise ValueError(f"expected a mapping such as {{type: {example}}}, got {quoted(value)}")
    return value


Choice = Annotated[dict[str, Any], BeforeValidator(_choice)]
"""A mapping with a ``type`` and the options of that type, before the registry is asked for the type."""


_GLASS_IOR = 1.52
"""Index of refraction of the glass of screens."""


class Medium(SpecModel):
    """What shows the source, paper or a screen: how dark its black, how bright its white, and the glass above it."""

    black: Fraction = Field("0%", validate_default=True, ge=0, lt=1, description="light that black reflects")
    white: Fraction = Field("100%", validate_default=True, gt=0, le=1, description="light that white reflects")

    glass: Length | None = Field(None, ge=0, le=100, description="glass of a screen between the source and the lens")

    @field_validator("white")
    @classmethod
    def _white_is_brighter(cls, value: float, info: ValidationInfo) -> float:
        black = info.data.get("black", 0.0)  # it is missing if it has a mistake of its own
        if value <= black:
            raise ValueError(f"white must be brighter than black, more than {FRACTION.text(black)}")
        return value

    @property
    def gap_mm(self) -> float:
        """The air that moves rays sideways as much as the glass does, to first order in their angles."""
        return (self.glass or 0.0) / _GLASS_IOR

    def shown(self, linear: FloatArray) -> FloatArray:
        """A picture as the medium shows it.

        Args:
            linear: Linear light of any shape, 0 to 1.

        Returns:
            Linear light, float32, of the same shape. 1 is the medium's white, since the eye adapts to that.
        """
        darkest = self.black / self.white
        seen: FloatArray = np.float32(darkest) + np.float32(1 - darkest) * linear
        return seen


def _machine(value: object) -> object:
    if value is not None and not isinstance(value, dict):
        raise ValueError(f"expected a mapping such as {{machine: printing}}, got {quoted(value)}")
    return value


MachineChoice = Annotated[dict[str, Any] | None, BeforeValidator(_machine)]
"""A mapping with a ``machine`` and the options of that machine, before the machine is looked up."""


class PipelineSpec(SpecModel):
    """Which stage of each kind runs, with which options."""

    matcher: Choice = Field({}, description="finds candidates for every facet")
    annealer: Choice = Field({}, description="chooses one candidate per facet")
    integrator: Choice = Field({}, description="turns choices into heights")
    finisher: Choice = Field({}, description="repairs and checks the mesh")
    encoder: Choice | None = Field(None, description="edits the source so that the finished lens shows the targets")
    exporters: list[Choice] = Field(
        [{"type": "stl"}], description="files to write; with a machine what it reads and the sheet, too, if left out"
    )
    renderers: list[Choice] = Field([{"type": "tracer"}], description="simulated photographs to take")
    rematch: int = Field(
        0, strict=True, ge=0, le=100,
        description="rounds of re-scoring candidates with the lens as it has become, while that helps",
    )  # fmt: skip
    codesign: int = Field(
        0, strict=True, ge=0, le=100, description="rounds of editing the source and designing the lens again for it"
    )

    def choice(self, kind: str, suited: Mapping[str, Choice]) -> Choice | None:
        """The mapping of the stage of a kind.

        What is written is laid over what suits the scenario, as long as both have the same type.

        Args:
            kind: A kind of which there is one stage.
            suited: Stages that suit the scenario and the machine, by kind.

        Returns:
            A type and its options; None if no encoder is wanted.
        """
        written: Choice | None = getattr(self, kind)
        wanted = kind in DEFAULT_STAGES or kind in suited or written is not None or self.codesign > 0
        if not wanted:
            return None
        written = written or {}
        usual = suited.get(kind) or {"type": self._default(kind)}
        return {**usual, **written} if written.get("type", usual["type"]) == usual["type"] else written

    @property
    def without_pymeshlab(self) -> bool:
        """Whether the finisher is left to magiclens, and the default one cannot run; options are taken as a choice."""
        return not self.finisher and not is_installed(PYMESHLAB)

    def _default(self, kind: str) -> str:
        if kind == "finisher" and self.without_pymeshlab:
            return FREE_FINISHER
        return DEFAULT_STAGES.get(kind, DEFAULT_ENCODER)


class ReportSpec(SpecModel):
    """What a run finds out about the finished lens, beyond its renders."""

    analyses: list[str] | None = Field(
        None, description="names of the analyses to run; all that apply to the lens if left out, none for []"
    )


_DEVICES = {"CON", "PRN", "AUX", "NUL", *(f"{port}{k}" for port in ("COM", "LPT") for k in range(1, 10))}
"""Names that Windows keeps for devices."""


class Spec(SpecModel):
    """A whole spec. Every key but ``scenario`` has a default."""

    # a folder gets this name: no slashes, and no dot at the start, which would hide it or leave the folder ('..')
    name: str = Field(
        "lens", max_length=100, pattern=r"^[A-Za-z0-9][A-Za-z0-9._ -]*$", description="names the run folder"
    )
    seed: int = Field(0, strict=True, ge=0, description="equal seeds give equal lenses")
    scenario: Choice = Field(description="what the lens shows, from where")
    lens: LensSpec = Field(default_factory=LensSpec, description="the lens itself")
    viewer: Viewer = Field(default_factory=Viewer, description="the eye")
    medium: Medium | None = Field(None, description="what shows the source, paper or screen; ideal if left out")
    fabrication: MachineChoice = Field(None, description="the machine that makes the lens: its limits hold")
    pipeline: PipelineSpec = Field(default_factory=PipelineSpec, description="the stages")
    report: ReportSpec = Field(default_factory=ReportSpec, description="what is found out about the finished lens")

    @field_validator("name")
    @classmethod
    def _name_of_a_folder(cls, value: str) -> str:
        if value.split(".")[0].strip().upper() in _DEVICES or value[-1] in ". ":
            raise ValueError(f"'{value}' cannot be the name of a folder on every system")
        return value
