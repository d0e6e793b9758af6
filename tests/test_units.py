"""Units in text outside, millimetres, degrees and fractions inside."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, Field, ValidationError

from magiclens.contract.units import (
    ANGLE,
    FRACTION,
    LENGTH,
    Angle,
    Fraction,
    Length,
    LengthOrPercent,
    Quantity,
    relative,
)


class Model(BaseModel):
    gap: Length = Field("10cm", validate_default=True)
    turn: Angle = Field("90deg", validate_default=True)
    share: Fraction = Field("10%", validate_default=True)
    window: LengthOrPercent = relative("10%")


@pytest.mark.parametrize(
    ("text", "mm"),
    [("100mm", 100), ("10cm", 100), ("0.1m", 100), ("2um", 0.002), ("2µm", 0.002), ("1in", 25.4), ("-1.5e1 mm", -15)],
)
def test_lengths_become_millimetres(text: str, mm: float) -> None:
    assert LENGTH.parse(text) == mm


@pytest.mark.parametrize(
    ("text", "degrees"), [("90deg", 90), ("0.02rad", 1.14591559026), ("20mrad", 1.14591559026), ("-1.15deg", -1.15)]
)
def test_angles_become_degrees(text: str, degrees: float) -> None:
    assert ANGLE.parse(text) == pytest.approx(degrees)


def test_shares_become_fractions() -> None:
    assert FRACTION.parse("10%") == 0.1


@pytest.mark.parametrize("number", [100, 100.0, "100"])
def test_a_bare_number_is_refused_and_a_unit_proposed(number: object) -> None:
    with pytest.raises(ValueError, match=r"100(\.0)? is a bare number; a length needs a unit, such as '100mm'"):
        LENGTH.parse(number)


@pytest.mark.parametrize(("number", "proposal"), [(0.1, "'10%'"), (10, "'10%'")])
def test_a_bare_share_is_proposed_in_percent(number: float, proposal: str) -> None:
    with pytest.raises(ValueError, match=proposal):
        FRACTION.parse(number)


@pytest.mark.parametrize(
    ("quantity", "value", "message"),
    [
        (LENGTH, "10deg", "unknown unit 'deg' in '10deg'; a length is in mm, cm, m, um, µm, in, such as '10mm'"),
        (LENGTH, "10mmm", "unknown unit 'mmm'"),
        (LENGTH, "wide", "expected a length such as '10mm', got 'wide'"),
        (LENGTH, True, "expected a length such as '10mm', got True"),
        (LENGTH, None, "expected a length"),
        (LENGTH, [1], "expected a length"),
        (LENGTH, "1e999mm", "too large"),
        (ANGLE, "90mm", "an angle is in deg, rad, mrad, such as '90deg'"),
        (FRACTION, "5mm", "a share is in %"),
    ],
)
def test_what_is_no_quantity_is_refused_with_an_example(quantity: Quantity, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        quantity.parse(value)


@given(st.floats(-1e6, 1e6), st.sampled_from([LENGTH, ANGLE, FRACTION]))
def test_text_gives_the_same_number_back(value: float, quantity: Quantity) -> None:
    once = quantity.parse(quantity.text(value))
    assert quantity.parse(quantity.text(once)) == once
    assert once == pytest.approx(value, rel=1e-11)


@given(st.from_regex(LENGTH.pattern, fullmatch=True))
def test_every_text_that_the_schema_accepts_is_read(text: str) -> None:
    number = re.match(LENGTH.pattern, text)
    assert number
    if abs(float(number[1])) < 1e300:
        LENGTH.parse(text)


def test_models_hold_numbers_and_dump_text() -> None:
    model = Model.model_validate({"turn": "0.5rad"})
    assert model.gap == 100.0
    assert model.model_dump(mode="json") == {
        "gap": "100mm",
        "turn": "28.6478897565deg",
        "share": "10%",
        "window": "10%",
    }


def test_a_dumped_model_reads_back_equal() -> None:
    model = Model.model_validate({"gap": "1.1in", "window": "0.3mm"})
    assert Model.model_validate(model.model_dump(mode="json")) == model


def test_a_length_or_a_percentage_is_told_of_what() -> None:
    assert relative("10%").mm(150) == 15
    assert relative("5mm").mm(150) == 5


def test_a_bare_length_or_percentage_is_refused() -> None:
    with pytest.raises(ValidationError, match="write a length such as '5mm' or a share such as '10%'"):
        Model.model_validate({"window": 5})


def test_schemas_describe_text_with_a_pattern() -> None:
    properties = Model.model_json_schema()["properties"]
    for name, text, wrong in [("gap", "10cm", "10"), ("turn", "9deg", "9mm"), ("window", "7%", "7")]:
        assert properties[name]["type"] == "string"
        assert re.search(properties[name]["pattern"], text)
        assert not re.search(properties[name]["pattern"], wrong)
