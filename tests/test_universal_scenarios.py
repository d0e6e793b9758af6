"""Scenarios of universal lenses: frames, questions, and what they reserve."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magiclens.config.model import Viewer
from magiclens.contract.artifacts import Lens
from magiclens.contract.errors import InputError
from magiclens.images.art import ART
from magiclens.images.files import write_png
from magiclens.images.movies import write_gif
from magiclens.plan.compile import load_plan
from magiclens.scenarios.question_answer import QuestionAnswer
from magiclens.scenarios.universal_animation import UniversalAnimation

LENS = Lens(size_mm=20, source_size_mm=20)
VIEWER = Viewer.model_validate({})
NAMES = {"art": set(ART)}


def animation(**keys: Any) -> UniversalAnimation:
    return UniversalAnimation.model_validate(keys, context=NAMES)


def questions(**keys: Any) -> QuestionAnswer:
    pairs = [
        {"question": {"type": "text", "text": "Why?", "box": ["10%", "40%", "90%", "60%"]}, "answer": {"art": "bat"}},
        {"question": {"type": "text", "text": "How?", "box": ["10%", "10%", "50%", "30%"]}, "answer": {"art": "key"}},
    ]
    return QuestionAnswer.model_validate({"pairs": pairs, **keys}, context=NAMES)


def test_a_built_in_loop_has_all_its_frames() -> None:
    shots = animation(frames={"art": "worm"}).shots(LENS, VIEWER)
    assert [shot.target.art for shot in shots] == [f"worm-{k}" for k in range(8)]
    assert len({shot.source_name for shot in shots}) == 8
    assert len({tuple(shot.eye_mm) for shot in shots}) == 1
    assert len(animation(frames={"art": "worm", "length": 3}).shots(LENS, VIEWER)) == 3


def test_a_movie_gives_one_view_per_frame(tmp_path: Path) -> None:
    levels = (0.1, 0.6)
    write_gif(tmp_path / "a.gif", [np.full((30, 20, 1), level, np.float32) for level in levels], 5)
    views = animation(frames={"movie": str(tmp_path / "a.gif")}).make_views(LENS, VIEWER, ART)
    assert [view.name for view in views] == ["frame-00", "frame-01"]
    for view, level in zip(views, levels, strict=True):
        assert view.target.shape[:2] == (30, 30)
        assert view.target[:, 10:20] == pytest.approx(level, abs=0.01)
        assert (view.source == 1).all()


def test_a_universal_lens_needs_its_own_stages_and_a_spec_may_change_them() -> None:
    plan = load_plan(Path("specs/universal-animation.yaml"), ["scenario.subdivisions=3", "pipeline.matcher.guard=6%"])
    assert plan.matcher.stage.type == "dart-throwing"
    assert (plan.matcher.choice()["subdivisions"], plan.matcher.choice()["guard"]) == (3, "6%")
    assert plan.encoder is not None
    assert plan.encoder.choice()["camouflage"]["type"] == "texture"
    again = plan.resolved()
    assert again["scenario"]["frames"] == {"art": "worm", "length": 8}


def test_a_mask_reserves_what_is_dark(tmp_path: Path) -> None:
    mask = np.ones((40, 40, 1), np.float32)
    mask[:10] = 0
    write_png(tmp_path / "mask.png", mask)
    reserved = animation(frames={"art": "worm"}, mask=str(tmp_path / "mask.png")).reserved(LENS, ART)
    assert reserved is not None
    assert reserved.shape == (300, 300)
    assert reserved[:75].all()
    assert not reserved[75:].any()
    assert animation(frames={"art": "worm"}).reserved(LENS, ART) is None


def test_questions_reserve_their_ink_and_a_margin() -> None:
    near, far = (questions(margin=margin).reserved(LENS, ART) for margin in ("0mm", "1mm"))
    assert near is not None
    assert far is not None
    for view in questions().make_views(LENS, VIEWER, ART):
        assert near[view.source[..., 0] < 0.9].all()
    assert not near[200:].any()
    assert (far >= near).all()
    rows, columns = np.nonzero(near)
    assert far[rows.max() + 14, columns[rows.argmax()]]
    assert not far[rows.max() + 17].any()


def test_a_lens_for_given_questions_reserves_nothing_and_paints_nothing() -> None:
    scenario = questions(lens="source-optimized")
    assert scenario.reserved(LENS, ART) is None
    assert scenario.suitable_stages()["matcher"]["type"] == "exhaustive"
    assert "encoder" not in scenario.suitable_stages()
    assert questions().suitable_stages()["matcher"]["type"] == "dart-throwing"


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ("{art: wurm}", "there is no built-in loop 'wurm'; choose one of: worm"),
        ("{art: worm, length: 9}", "'worm' has 8 frames, not 9"),
        ("{}", "name the frames"),
        ("{art: worm, movie: a.gif}", "name the frames|there is no file"),
        ("{images: []}", "needs at least 1"),
        ("{movie: nothing.gif}", "there is no file"),
    ],
)
def test_wrong_frames_get_one_clear_message(tmp_path: Path, frames: str, message: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(f"scenario:\n  type: universal-animation\n  frames: {frames}\n")
    with pytest.raises(InputError, match=message) as caught:
        load_plan(path)
    assert "a.yaml:3" in str(caught.value)
