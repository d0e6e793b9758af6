"""The product that a solid is the shape of, and its units (ISO 10303-41, AP214)."""

from __future__ import annotations

from mlens_step.part21 import Part21, Ref

_ACCURACY_MM = 1e-6
"""Distance below which points count as one: far below the width of a wall."""


def add_product(file: Part21, solid: Ref, name: str, description: str) -> None:
    """A product whose shape is one solid, in millimetres."""
    application = file.add("APPLICATION_CONTEXT", "core data for automotive mechanical design processes")
    standard = "international standard"
    file.add("APPLICATION_PROTOCOL_DEFINITION", standard, "automotive_design", 2000, application)
    context = file.add("PRODUCT_CONTEXT", "", application, "mechanical")
    product = file.add("PRODUCT", name, name, description, (context,))
    file.add("PRODUCT_RELATED_PRODUCT_CATEGORY", "part", None, (product,))
    formation = file.add("PRODUCT_DEFINITION_FORMATION", "", "", product)
    stage = file.add("PRODUCT_DEFINITION_CONTEXT", "part definition", application, "design")
    definition = file.add("PRODUCT_DEFINITION", "design", "", formation, stage)
    shape = file.add("PRODUCT_DEFINITION_SHAPE", "", "", definition)
    origin = file.add("CARTESIAN_POINT", "", (0.0, 0.0, 0.0))
    axes = [file.add("DIRECTION", "", axis) for axis in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0))]
    placement = file.add("AXIS2_PLACEMENT_3D", "", origin, *axes)
    brep = file.add("ADVANCED_BREP_SHAPE_REPRESENTATION", "", (placement, solid), _units(file))
    file.add("SHAPE_DEFINITION_REPRESENTATION", shape, brep)


def _units(file: Part21) -> Ref:
    """Three dimensions, in millimetres and radians."""
    length = file.add_complex("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    angle = file.add_complex("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid_angle = file.add_complex("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    accuracy = file.add_complex(
        f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE({_ACCURACY_MM:.1E}),#{length:d},'distance_accuracy_value','')"
    )
    return file.add_complex(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{accuracy:d}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT((#{length:d},#{angle:d},#{solid_angle:d}))REPRESENTATION_CONTEXT('',''))"
    )
