"""STEP: the lens as a CAD solid (ISO 10303-21, application protocol 214)."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field, field_validator

from magiclens import Exporter, InputError, Length, LengthOrPercent, Lens, Scene, Solid, relative


class Step(Exporter):
    """A solid in millimetres for CAD programs: every facet one smooth face, all edges shared, one closed shell.

    Facets become bicubic B-splines through the vertices of the mesh, of as few control points as the tolerance allows,
    or with a knot at every vertex if they are free-form; walls and sides that are not flat become ruled faces between
    the facets' edges.
    """

    type: ClassVar[str] = "step"
    suffix: ClassVar[str] = ".step"

    surface: Literal["splines", "triangles"] = Field(
        "splines", description="one smooth face per facet, or the triangles of the mesh as they are, 50,000 at most"
    )
    tolerance: Length = Field(
        "0.1um",
        validate_default=True,
        ge=0,
        le=1000,
        description="`splines` only: how far a vertex of the mesh may be off",
    )
    departure: LengthOrPercent = Field(
        relative("100%"),
        description="`splines` only: how far the smooth surface may leave the micro-facets between their vertices, "
        "of a micro-facet's width",
    )

    @field_validator("departure")
    @classmethod
    def _is_one_that_surfaces_can_keep(cls, value: LengthOrPercent) -> LengthOrPercent:
        if not 1e-3 <= value.mm(1.0) <= 1000:
            raise ValueError("must be between 1um and 1000mm, or 0.1% and 100000% of a micro-facet")
        return value

    def require_possible(self, lens: Lens) -> None:
        """A foot with a mark is no rectangle, on which splines stand."""
        if lens.mark and self.surface == "splines":
            raise InputError("splines have no mark; write 'surface: triangles', or lens.mark: false", keys=("surface",))

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        """Write the file. Raises InputError if the solid is not of the kind that ``surface`` needs."""
        from mlens_step.body import lens_body
        from mlens_step.part21 import Part21
        from mlens_step.product import add_product
        from mlens_step.shell import add_lens
        from mlens_step.splines import smooth_net, um
        from mlens_step.triangles import add_triangles, check_triangles

        lens = scene.lens
        name = f"Magic lens, {lens.size_mm:g} x {lens.size_mm:g} mm, index of refraction {lens.ior:g}"
        if self.surface == "triangles":
            check_triangles(solid)
            how = "the mesh's triangles"
        else:
            body = lens_body(lens, solid)
            departure_mm = self.departure.mm(lens.pitch_mm / lens.microfacets)
            net = smooth_net(body.top, lens.facets, body.rim, self.tolerance, departure_mm)
            how = f"facets within {um(net.miss_mm)} of the mesh's vertices, {um(net.departure_mm)} of its micro-facets"
        with path.open("w", encoding="ascii", newline="\n") as text:
            file = Part21(text, path.name, f"{name}; {how}")
            shape = add_triangles(file, solid) if self.surface == "triangles" else add_lens(file, body, net)
            add_product(file, shape, "lens", name)
            file.close()
