"""The studio: who is let in, what is taken and served, and jobs that outlive the server."""

from __future__ import annotations

import asyncio
import io
import json
import os
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import quote
from zipfile import ZipFile

import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageSequence
from starlette.testclient import TestClient
from typer.testing import CliRunner

from magiclens import InputError
from magiclens.cli import app as command_line
from magiclens.plan.compile import load_plan
from magiclens.studio import server
from magiclens.studio.guard import Door
from magiclens.studio.results import run_summary
from magiclens.studio.server import Studio, studio_app
from magiclens.studio.sharing import film_to_share
from magiclens.studio.store import StudioFolder, file_below, sole_user
from magiclens.studio.worker import Worker

PORT = 8765
HOME = f"http://127.0.0.1:{PORT}"
PROGRAM = """
import json, os, pathlib, sys, time
what, *rest = sys.argv[1:]
if what == "run":
    print("matcher exhaustive   1 s", file=sys.stderr, flush=True)
    while os.path.exists("../../hold"):
        time.sleep(0.02)
    if os.path.exists("../../fail"):
        print("error: spec.yaml:3: too steep", file=sys.stderr)
        sys.exit(2)
    folder = pathlib.Path(rest[rest.index("--out") + 1])
    folder.mkdir(exist_ok=True)
    (folder / "called.json").write_text(json.dumps(rest))
    manifest = {"views": [], "artifacts": [], "metrics": {}, "scene": {"facets": 8}}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / "report.html").write_text("<p>a report</p>")
    (folder / "lens.stl").write_text("solid")
"""


def png(sides: int = 3, size: int = 64, format: str = "PNG") -> bytes:
    image, out = Image.new("L", (size, size), 255), io.BytesIO()
    ImageDraw.Draw(image).regular_polygon((size / 2, size / 2, size / 3), sides, fill=0)
    image.save(out, format)
    return out.getvalue()


class Visitor:
    """A browser that came with the token, and what stands behind the server."""

    def __init__(self, root: Path, door: Door):
        self.store, self.door = StudioFolder(root), door
        self.worker = Worker(self.store, [sys.executable, "-c", PROGRAM])
        self.app = studio_app(self.store, self.worker, door)
        self.client = TestClient(self.app, base_url=HOME, headers={"origin": HOME}, raise_server_exceptions=True)

    def add(self, name: str = "star.png", content: bytes | None = None) -> str:
        done = self.client.post(f"/api/pictures?name={quote(name)}", content=png() if content is None else content)
        assert done.status_code == 201, done.text
        return str(done.json()["name"])

    def order(self, **values: Any) -> str:
        done = self.client.post("/api/jobs", json={"pictures": [self.add()], "machine": "sla", **values})
        assert done.status_code == 201, done.text
        return str(done.json()["id"])

    def wait(self, job: str, *states: str) -> dict[str, Any]:
        end = time.monotonic() + 30
        while time.monotonic() < end:
            found = next(j for j in self.client.get("/api/state").json()["jobs"] if j["id"] == job)
            if found["state"] in states:
                return dict(found)
            time.sleep(0.02)
        raise AssertionError(f"{found['state']}, not {states}")


@pytest.fixture
def visit(tmp_path: Path) -> Iterator[Callable[[], Visitor]]:
    """Starts a studio in the same folder, again if it is called again."""
    opened: list[Visitor] = []

    def start() -> Visitor:
        if opened:
            opened.pop().client.__exit__(None, None, None)
        visitor = Visitor(tmp_path / "studio", Door(PORT))
        visitor.client.__enter__()
        assert visitor.client.get(f"/?token={visitor.door.token}").status_code == 200
        opened.append(visitor)
        return visitor

    yield start
    (tmp_path / "studio" / "hold").unlink(missing_ok=True)
    for visitor in opened:
        visitor.client.__exit__(None, None, None)


ADDRESSES = [
    ("GET", "/"), ("GET", "/static/main.js"), ("GET", "/api/state"), ("GET", "/api/events"), ("POST", "/api/pictures"),
    ("DELETE", "/api/pictures/a.png"), ("POST", "/api/specs"), ("POST", "/api/jobs"),
    ("POST", "/api/jobs/0001-00000000/cancel"), ("DELETE", "/api/jobs/0001-00000000"), ("GET", "/pictures/a.png"),
    ("GET", "/jobs/0001-00000000/spec.yaml"), ("GET", "/api/previews/a.png"), ("POST", "/api/forecasts"),
    ("DELETE", "/api/results"),
]  # fmt: skip


def test_every_address_of_the_server_is_in_the_list_that_is_attacked(visit: Callable[[], Visitor]) -> None:
    assert len(visit().app.routes) == len(ADDRESSES)


@pytest.mark.parametrize(("method", "path"), ADDRESSES)
def test_nobody_enters_without_token_from_another_page_or_by_another_name(
    visit: Callable[[], Visitor], method: str, path: str
) -> None:
    visitor = visit()
    cookie = dict(visitor.client.cookies)
    stranger = TestClient(visitor.app, base_url=HOME)
    for headers, cookies in [
        ({"origin": HOME}, {}),
        ({"origin": HOME}, {visitor.door.cookie: "x" * 43}),
        ({"origin": HOME}, {visitor.door.cookie: "é"}),
        ({"origin": "https://evil.example"}, cookie),
        ({"origin": "null"}, cookie),
        ({"origin": HOME, "host": "evil.example"}, cookie),
        ({"origin": HOME, "host": f"127.0.0.1:{PORT + 1}"}, cookie),
        *([({}, cookie)] if method != "GET" else []),
    ]:
        stranger.cookies.clear()
        words = "; ".join(f"{key}={value}" for key, value in cookies.items())
        sent = {**headers, **({"cookie": words} if words else {})}
        done = stranger.request(method, path, headers={key: value.encode() for key, value in sent.items()})
        assert done.status_code == 403, (headers, cookies)
        assert done.headers["x-content-type-options"] == "nosniff"
    assert stranger.get("/?token=wrong").status_code == 403
    assert stranger.get(f"/api/state?token={visitor.door.token}").status_code == 403


def test_the_token_becomes_a_cookie_that_no_other_page_sends_or_reads(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    done = TestClient(visitor.app, base_url=HOME).get(f"/?token={visitor.door.token}")
    said = done.headers["set-cookie"].lower()
    assert "samesite=strict" in said
    assert "httponly" in said
    assert "default-src 'none'" in done.headers["content-security-policy"]
    assert visitor.door.token not in done.text
    assert Door(PORT).token != Door(PORT).token


def test_a_reverse_proxy_is_let_in_by_its_origin(tmp_path: Path) -> None:
    visitor = Visitor(tmp_path, Door(PORT, ["https://studio.example.org"]))
    proxied = TestClient(visitor.app, base_url="https://studio.example.org")
    assert proxied.get(f"/?token={visitor.door.token}").status_code == 200
    assert proxied.get("/api/state").status_code == 200
    done = proxied.post("/api/pictures", content=png(), headers={"origin": "https://studio.example.org"})
    assert done.status_code == 201


def test_the_page_asks_for_nothing_elsewhere(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    page = visitor.client.get("/").text
    for name in server._SCRIPTS:
        script = visitor.client.get(f"/static/{name}")
        assert script.headers["content-type"].startswith("text/javascript")
        page += script.text
    assert "http://" not in page
    assert "https://" not in page
    assert visitor.client.get("/static/studio.html").status_code == 404


def test_pictures_are_kept_as_png_under_plain_names(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    assert visitor.add("../../Ünder <b>.JPG", png(4, format="JPEG")) == "nder-b.png"
    assert visitor.add("a.png") == "a.png"
    assert visitor.add("a.png") == "a.png", "the same picture again"
    assert visitor.add("a.png", png(5)) == "a-2.png"
    assert visitor.add("123.png") == "picture-123.png"
    kept = visitor.client.get("/pictures/nder-b.png")
    assert kept.headers["content-type"] == "image/png"
    assert Image.open(io.BytesIO(kept.content)).format == "PNG"
    assert visitor.client.delete("/api/pictures/a.png").status_code == 204
    assert visitor.client.delete("/api/pictures/a.png").status_code == 404


HOSTILE = {
    "nothing": b"",
    "text": b"hello",
    "page": b"<script>alert(1)</script>",
    "vector": b"<svg xmlns='http://www.w3.org/2000/svg' width='40' height='40'><image href='/etc/hostname'/></svg>",
    "postscript": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 1 1\n",
    "cut off": png()[:80],
    "bomb": png()[:16] + (60_000).to_bytes(4, "big") * 2 + png()[24:],
    "animation": b"GIF89a" + bytes(20),
    "zip": b"PK\x03\x04" + bytes(60),
}


@pytest.mark.parametrize("content", HOSTILE.values(), ids=HOSTILE)
def test_hostile_uploads_are_refused_in_words(visit: Callable[[], Visitor], content: bytes) -> None:
    visitor = visit()
    done = visitor.client.post("/api/pictures?name=evil.png", content=content)
    assert done.status_code == 422
    (error,) = done.json()["errors"]
    assert str(visitor.store.root) not in error["message"]
    assert visitor.store.pictures() == []
    assert not list(visitor.store.root.glob(".new-*"))


def garbled() -> dict[str, bytes]:
    """Pictures that were cut off, or in which bytes were changed, and files that claim to be what they are not."""
    rng, found = np.random.default_rng(0), {}
    for kind in ("PNG", "JPEG", "GIF", "WEBP", "TIFF", "BMP"):
        whole = png(5, 64, kind)
        found |= {f"{kind} cut at {share:g}": whole[: int(share * len(whole))] for share in (0.05, 0.3, 0.7)}
        for tries in range(2):
            content = np.frombuffer(whole, np.uint8).copy()
            content[rng.integers(8, len(content), 20)] = rng.integers(0, 256, 20)
            found[f"{kind} changed, {tries}"] = content.tobytes()
        found[f"{kind} with noise"] = whole[:12] + rng.bytes(500)
    return found


def test_garbled_uploads_are_served_or_refused_in_words(visit: Callable[[], Visitor]) -> None:
    visitor, uploads = visit(), garbled()
    assert len(uploads) + len(HOSTILE) >= 40
    for what, content in uploads.items():
        done = visitor.client.post("/api/pictures?name=..%2F..%2Fevil.png", content=content)
        assert done.status_code in (201, 422), what
        assert str(visitor.store.root) not in done.text
        assert "Traceback" not in done.text
    assert not list(visitor.store.root.glob(".new-*"))
    assert [path.name for path in visitor.store.root.parent.iterdir()] == ["studio"]


def test_too_large_and_too_many_uploads_are_refused(
    visit: Callable[[], Visitor], monkeypatch: pytest.MonkeyPatch
) -> None:
    visitor = visit()
    assert visitor.client.post("/api/pictures", content=bytes(server.MOST_UPLOAD_BYTES + 1)).status_code == 413
    assert visitor.client.post("/api/jobs", content=bytes(600_000)).status_code == 413
    monkeypatch.setattr("magiclens.studio.store.MOST_PICTURES", 1)
    monkeypatch.setattr("magiclens.studio.store.MOST_JOBS", 0)
    name = visitor.add()
    assert "delete some first" in visitor.client.post("/api/pictures", content=png(7)).text
    assert "delete some first" in visitor.client.post("/api/jobs", json={"pictures": [name]}).text
    assert visitor.store.jobs() == []


def test_two_hundred_ways_out_of_the_folder_lead_nowhere(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    job = visitor.order()
    visitor.wait(job, "done")
    folder = visitor.store.root / "jobs" / job
    (visitor.store.root.parent / "secret").write_text("secret")
    (folder / "draft" / "link").symlink_to(visitor.store.root.parent / "secret")
    (folder / "draft" / "linked").symlink_to(visitor.store.root.parent)
    (visitor.store.root / "pictures" / "link.png").symlink_to(visitor.store.root.parent / "secret")
    ups = ["..", "%2e%2e", ".%2e", "%252e%252e", "..%2f..", "..%5c..", "....//..", "%c0%ae%c0%ae", "..%00", "."]
    starts = [f"/jobs/{job}/draft", f"/jobs/{job}", "/jobs", "/pictures", "/static"]
    ends = ["secret", "../secret", "../../../secret", "etc/passwd"]
    paths = [f"{start}/{up}/{end}" for up in ups for start in starts for end in ends]
    paths += [f"/jobs/{job}/draft/link", f"/jobs/{job}/draft/linked/secret", "/pictures/link.png"]
    paths += [f"/jobs/{job}/job.json", f"/jobs/{job}/draft//etc/passwd", f"/jobs/{job}/draft/{'a' * 300}"]
    paths += [f"/jobs/{job}/draft/%00", "/jobs/../spec.yaml", f"/jobs/{job}/full/report.html", "/jobs//x"]
    assert len(set(paths)) > 200
    for path in paths:
        done = raw_get(visitor, path)
        assert done[0] == 404, path
        assert b"secret" not in done[1]
        assert b"Traceback" not in done[1]
    assert visitor.client.get(f"/jobs/{job}/draft/report.html").text == "<p>a report</p>"


def raw_get(visitor: Visitor, path: str) -> tuple[int, bytes]:
    """Status and body of a path that no client has tidied."""
    from urllib.parse import unquote

    cookie = f"{visitor.door.cookie}={visitor.door.token}".encode()
    headers = [(b"host", f"127.0.0.1:{PORT}".encode()), (b"cookie", cookie)]
    scope = {"type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": "GET", "scheme": "http",
             "path": unquote(path), "raw_path": path.encode(), "query_string": b"", "root_path": "", "headers": headers,
             "server": ("127.0.0.1", PORT), "client": ("127.0.0.1", 1)}  # fmt: skip
    sent: list[Any] = []

    async def receive() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(visitor.app(scope, receive, send))
    return sent[0]["status"], b"".join(message.get("body", b"") for message in sent[1:])


def test_files_below_a_folder_are_found_and_no_others(tmp_path: Path) -> None:
    (tmp_path / "in" / "deep").mkdir(parents=True)
    (tmp_path / "in" / "deep" / "a").touch()
    assert file_below(tmp_path / "in", "deep/a") == tmp_path / "in" / "deep" / "a"
    (tmp_path / "b").touch()
    for path in ("../b", "deep", "", "/", "deep/../deep/a", "deep//a", str(tmp_path / "b"), "a\0", "deep\\a"):
        assert file_below(tmp_path / "in", path) is None


def test_files_of_runs_have_the_policy_that_lets_them_ask_for_nothing(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    job = visitor.order()
    visitor.wait(job, "done")
    report = visitor.client.get(f"/jobs/{job}/draft/report.html")
    assert "connect-src blob: data:" in report.headers["content-security-policy"]
    mesh = visitor.client.get(f"/jobs/{job}/draft/lens.stl")
    assert mesh.headers["content-disposition"].startswith("attachment")
    assert visitor.client.get(f"/jobs/{job}/spec.yaml").headers["content-type"].startswith("text/plain")


@pytest.mark.parametrize(("scenario", "pictures"), [("single", 1), ("rotating", 2), ("universal-animation", 1)])
def test_orders_become_specs_that_the_command_line_takes(
    visit: Callable[[], Visitor], tmp_path: Path, scenario: str, pictures: int
) -> None:
    visitor = visit()
    names = [visitor.add(f"p{k}.png", png(3 + k)) for k in range(pictures)]
    order = {"scenario": scenario, "pictures": names, "machine": "lcd-8k", "size": "40mm"}
    text = visitor.client.post("/api/specs", json=order).json()["yaml"]
    for name in names:
        (tmp_path / name).write_bytes((visitor.store.root / "pictures" / name).read_bytes())
    (tmp_path / "copied.yaml").write_text(text)
    plan = load_plan(tmp_path / "copied.yaml", sandbox=True)
    assert plan.scenario.type == scenario
    assert plan.lens.size_mm == 40.0
    assert "lcd-8k" in text
    job = visitor.client.post("/api/jobs", json={"yaml": text}).json()["id"]
    assert visitor.client.get(f"/jobs/{job}/spec.yaml").text == text
    called = visitor.wait(job, "done") and json.loads((visitor.store.job_folder(job) / "draft/called.json").read_text())
    draft = load_plan(tmp_path / "copied.yaml", [w for k, w in enumerate(called) if k and called[k - 1] == "--set"])
    assert draft.lens.facets <= 12
    assert draft.lens.microfacets <= 16
    assert [step.stage.type for step in draft.renderers] == ["tracer"]
    assert "--sandbox" in called


def test_mistakes_of_a_spec_are_told_with_their_lines_and_no_path(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    text = "scenario: {type: single, source: {type: circles}, target: {image: /etc/passwd}}\nlens:\n  facetts: 8\n"
    done = visitor.client.post("/api/jobs", json={"yaml": text})
    assert done.status_code == 422
    places = {error["where"] for error in done.json()["errors"]}
    assert {"spec.yaml:1", "spec.yaml:3"} <= places
    assert str(visitor.store.root) not in done.text
    assert visitor.store.jobs() == []


@pytest.mark.parametrize(
    "body",
    [b"", b"[", b"null", b'{"yaml": 3}', b'{"what": 1}', b'{"scenario": "no"}', b'{"pictures": ["../job.json"]}',
     b'{"machine": "fdm", "pictures": ["star.png"]}', b'{"size": "1", "pictures": ["star.png"]}', b"\xff",
     b'{"yaml": "a: &a [*a]"}', b'{"yaml": "' + b"[" * 5000 + b'"}', b'{"yaml": "\\ud800"}',
     b'{"size": "1000000mm", "pictures": ["star.png"]}', b'{"scenario": "rotating", "pictures": ["star.png"]}'],
)  # fmt: skip
def test_orders_that_are_none_are_refused_in_words(visit: Callable[[], Visitor], body: bytes) -> None:
    visitor = visit()
    visitor.add()
    for path in ("/api/jobs", "/api/specs"):
        done = visitor.client.post(path, content=body)
        assert done.status_code == 422, done.text
        assert done.json()["errors"][0]["message"]
    assert visitor.store.jobs() == []


def test_a_draft_comes_first_and_the_full_design_on_request(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    job = visitor.order()
    assert set(visitor.wait(job, "done")["runs"]) == {"draft"}
    assert visitor.client.post(f"/api/jobs/{job}/full").status_code == 204
    assert set(visitor.wait(job, "done")["runs"]) == {"draft", "full"}
    called = json.loads((visitor.store.job_folder(job) / "full/called.json").read_text())
    assert "--set" not in called
    assert visitor.client.post(f"/api/jobs/{job}/nothing").status_code == 404
    assert visitor.client.delete(f"/api/jobs/{job}").status_code == 204
    assert visitor.client.delete(f"/api/jobs/{job}").status_code == 404
    assert not list((visitor.store.root / "jobs").iterdir())


def test_jobs_run_one_at_a_time_and_can_be_cancelled(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    hold = visitor.store.root / "hold"
    hold.touch()
    first, second = visitor.order(), visitor.order()
    visitor.wait(first, "running")
    assert visitor.wait(second, "waiting")
    assert visitor.client.delete(f"/api/jobs/{first}").status_code == 409
    visitor.client.post(f"/api/jobs/{first}/cancel")
    visitor.wait(first, "cancelled")
    visitor.wait(second, "running")
    third = visitor.order()
    visitor.client.post(f"/api/jobs/{third}/cancel")
    assert visitor.wait(third, "cancelled")["runs"] == {}
    hold.unlink()
    visitor.wait(second, "done")


def test_a_run_that_fails_says_why(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    (visitor.store.root / "fail").touch()
    job = visitor.order()
    assert visitor.wait(job, "failed")["said"] == "error: spec.yaml:3: too steep"
    (visitor.store.root / "fail").unlink()
    visitor.client.post(f"/api/jobs/{job}/draft")
    assert visitor.wait(job, "done")["said"] == ""


def test_a_job_that_ran_when_the_studio_ended_goes_on(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    (visitor.store.root / "hold").touch()
    running, waiting = visitor.order(), visitor.order()
    visitor.wait(running, "running")
    again = visit()
    again.wait(running, "running")
    assert again.client.get("/pictures/star.png").status_code == 200
    (visitor.store.root / "hold").unlink()
    again.wait(running, "done")
    again.wait(waiting, "done")


def test_a_run_that_outlived_its_studio_is_ended_before_it_begins_again(
    visit: Callable[[], Visitor], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("magiclens.studio.worker.PATIENCE_S", 0.3)
    visitor = visit()
    (visitor.store.root / "hold").touch()
    job = visitor.order()
    end = time.monotonic() + 60
    while (lost := visitor.store.state(job).get("process")) is None:  # noted once it is there: the job runs before
        assert time.monotonic() < end, "the job was not begun"
        time.sleep(0.05)
    visitor.worker.end_child = lambda: None  # as if the studio had been killed
    again = visit()
    while again.store.state(job).get("process") in (lost, None):
        assert time.monotonic() < end, "the job was not begun again"
        time.sleep(0.05)
    again.wait(job, "running")
    assert not Path(f"/proc/{lost}/cmdline").exists() or not Path(f"/proc/{lost}/cmdline").read_bytes()
    (visitor.store.root / "hold").unlink()
    again.wait(job, "done")


def test_a_spec_is_given_with_its_pictures(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    job = visitor.order()
    content = visitor.client.get(f"/jobs/{job}/spec.zip").content
    assert content == visitor.client.get(f"/jobs/{job}/spec.zip").content
    with ZipFile(io.BytesIO(content)) as packed:
        assert packed.namelist() == ["spec.yaml", "star.png"]
        assert packed.read("spec.yaml").decode() == visitor.client.get(f"/jobs/{job}/spec.yaml").text


def test_kept_results_are_cleared_and_all_else_stays(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    cache = visitor.store.root / "cache"
    for name in ("entries-1/a.npz", "files-1/b"):
        (cache / name).parent.mkdir(exist_ok=True)
        (cache / name).write_bytes(b"x" * 1000)
    before = visitor.client.get("/api/state").json()
    assert before["kept_bytes"] == 2000
    assert visitor.client.delete("/api/results").status_code == 204
    after = visitor.client.get("/api/state").json()
    assert (after["kept_bytes"], before["bytes"] - after["bytes"]) == (0, 2000)


def test_pictures_are_previewed_as_a_spec_would_show_them(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    image, out = Image.new("L", (200, 100), 255), io.BytesIO()
    ImageDraw.Draw(image).rectangle((80, 20, 120, 80), fill=0)
    image.save(out, "PNG")
    name = visitor.add("wide.png", out.getvalue())
    shown = {crop: visitor.client.get(f"/api/previews/{name}?crop={crop}").json() for crop in ("centre", "fit")}
    assert shown["centre"]["picture"] != shown["fit"]["picture"]
    assert "middle square" in " ".join(shown["centre"]["reasons"])
    spec = visitor.client.post("/api/specs", json={"pictures": [name], "crop": "centre"}).json()["yaml"]
    assert "fit: crop" in spec
    blank = io.BytesIO()
    Image.new("L", (64, 64), 128).save(blank, "PNG")
    for path in (f"{name}?crop=round", "no.png", visitor.add("blank.png", blank.getvalue())):
        done = visitor.client.get(f"/api/previews/{path}")
        assert done.status_code == 422
        assert str(visitor.store.root) not in done.text


def test_contrast_and_ground_are_previewed_and_written(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    ramp = Image.fromarray(np.tile(np.linspace(30, 225, 64).astype(np.uint8), (64, 1)))
    out = io.BytesIO()
    ramp.save(out, "PNG")
    name = visitor.add("ramp.png", out.getvalue())
    asked = ("contrast=0", "contrast=0.6", "ground=light", "ground=dark")
    shown = {each: visitor.client.get(f"/api/previews/{name}?{each}").json()["picture"] for each in asked}
    assert len(set(shown.values())) == 3
    assert shown["ground=light"] != shown["ground=dark"]
    order = {"pictures": [name], "contrast": 0.6, "ground": "dark", "facets": 20, "thickness": "31mm", "machine": "sla"}
    order |= {"paper": "letter", "jig": True}
    spec = visitor.client.post("/api/specs", json=order).json()["yaml"]
    for words in ("levels: [", "facets: 20", "thickness: 31mm", "{type: sheet, paper: letter}", "{type: jig}"):
        assert words in spec
    for wrong in ("contrast=much", "contrast=1", "contrast=nan", "ground=green"):
        assert visitor.client.get(f"/api/previews/{name}?{wrong}").status_code == 422


def test_what_an_order_takes_is_known_before_anything_is_designed(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    order = {"pictures": [visitor.add()], "machine": "sla", "size": "40mm"}

    def rows(**values: Any) -> dict[str, list[str]]:
        done = visitor.client.post("/api/forecasts", json=order | values)
        assert done.status_code == 200, done.text
        return {label: rest for label, *rest in done.json()["rows"]}

    small, large, thick = rows(), rows(size="80mm"), rows(thickness="50mm")
    kilograms = [float(each["Material"][0].split(" kg")[0]) for each in (small, large, thick)]
    assert kilograms[0] < min(kilograms[1:])
    assert thick["Printing"] != small["Printing"]
    assert "EUR" in small["Material"][0]
    assert rows(facets=60)["Detail"][1] != "green"
    assert small["Verdict"] == ["after the draft", ""]
    visitor.wait(visitor.order(**order), "done")
    assert visitor.store.jobs()
    assert "block" not in rows(machine="milling")["Material"][0]
    assert visitor.client.post("/api/forecasts", json=order | {"facets": 1}).status_code == 422
    assert not list(visitor.store.root.glob(".new-*"))


def test_an_equal_job_lends_its_verdict(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    order = {"pictures": [visitor.add()], "machine": "sla", "size": "40mm"}
    job = visitor.order(**order)
    visitor.wait(job, "done")
    run = visitor.store.root / "jobs" / job / "full"
    run.mkdir()
    scene = {"views": [], "artifacts": [], "scene": {"facets": 8}, "metrics": {"tolerance_shift_x_mm": 0.25}}
    (run / "manifest.json").write_text(json.dumps(scene))
    verdict = {"status": "green", "text": "as printed: clear"}
    (run / "preflight.json").write_text(json.dumps({"verdict": verdict, "checks": []}))
    for contrast, wanted, color, tolerance in (
        (0.0, "as printed: clear", "green", "0.25 mm"), (0.5, "after the draft", "", "after the full design")
    ):  # fmt: skip
        rows = visitor.client.post("/api/forecasts", json=order | {"contrast": contrast}).json()["rows"]
        found = {label: rest for label, *rest in rows}
        assert found["Verdict"] == [wanted, color]
        assert tolerance in found["Tolerance"][0]


def test_a_film_to_share_begins_with_the_sheet_and_ends_with_the_picture(tmp_path: Path) -> None:
    for name, content in (("sheet.png", png(3)), ("seen.png", png(5)), ("made.png", png(4))):
        (tmp_path / name).write_bytes(content)
    views = [{"source": "sheet.png", "designed": "seen.png", "made": "made.png"}]
    with Image.open(io.BytesIO(film_to_share(tmp_path, views))) as film:
        frames = [np.asarray(frame.convert("L"), float) for frame in ImageSequence.Iterator(film)]
        assert film.info["loop"] == 0
    for frame, name in ((frames[0], "sheet.png"), (frames[-1], "made.png")):
        wanted = Image.open(tmp_path / name).convert("L").resize(frame.shape, Image.Resampling.LANCZOS)
        assert np.abs(frame - np.asarray(wanted, float)).mean() < 4
    assert len(frames) > 6


def test_changes_are_told_as_events(visit: Callable[[], Visitor]) -> None:
    visitor = visit()

    async def two_events() -> list[str]:
        changes = Studio(visitor.store, visitor.worker, visitor.door)._changes()
        first = await anext(changes)
        visitor.store.touch()
        return [first, await anext(changes)]

    for event in asyncio.run(two_events()):
        assert set(json.loads(event.removeprefix("data: "))) == {"pictures", "jobs", "bytes", "kept_bytes"}


def test_requests_side_by_side_are_all_answered(visit: Callable[[], Visitor]) -> None:
    visitor = visit()
    (visitor.store.root / "hold").touch()

    def one(k: int) -> int:
        if k % 3 == 0:
            return visitor.client.post(f"/api/pictures?name=p{k % 4}.png", content=png(3 + k % 5)).status_code
        if k % 3 == 1:
            return visitor.client.get("/api/state").status_code
        return visitor.client.post("/api/jobs", json={"yaml": "lens: {}"}).status_code

    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(one, range(50)))
    assert set(answers) == {200, 201, 422}
    assert len({(visitor.store.root / "pictures" / n).read_bytes() for n in visitor.store.pictures()}) <= 5


def test_a_folder_has_one_studio(tmp_path: Path) -> None:
    with sole_user(tmp_path / "s"), pytest.raises(InputError, match="another studio"), sole_user(tmp_path / "s"):
        pass
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be used"), sole_user(tmp_path / "file"):
        pass


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--port", "70000"], "cannot be had"), (["--origin", "studio.example.org"], "is no origin")],
)
def test_the_command_refuses_what_it_cannot_serve(tmp_path: Path, arguments: list[str], words: str) -> None:
    done = CliRunner().invoke(command_line, ["studio", "--folder", str(tmp_path), "--no-open", *arguments])
    assert done.exit_code == 2
    assert words in done.stderr


def test_without_the_extra_the_command_says_what_to_install() -> None:
    code = textwrap.dedent("""
        import sys
        sys.modules["starlette"] = sys.modules["uvicorn"] = None
        from magiclens.cli import main
        main()
    """)
    done = subprocess.run(
        [sys.executable, "-c", code, "studio", "--no-open"], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 2
    assert "pip install 'magiclens[studio]'" in done.stderr


def test_half_written_runs_are_not_shown(tmp_path: Path) -> None:
    assert run_summary(tmp_path) is None
    (tmp_path / "manifest.json").write_text('{"views": [')
    assert run_summary(tmp_path) is None
    assert os.listdir(tmp_path) == ["manifest.json"]
