"""The studio's server: what each address answers, and how it is started."""

from __future__ import annotations

import asyncio
import json
import re
import socket
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import uvicorn
from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from magiclens.contract.errors import InputError, MagicLensError
from magiclens.new.layouts import LAYOUTS
from magiclens.new.write import treatment_of
from magiclens.pages.templating import render_page, template_text
from magiclens.profiles.machines import machines
from magiclens.studio.foreseen import foreseen
from magiclens.studio.guard import RUN_POLICY, Door, Guard
from magiclens.studio.orders import PACKED, SPEC, Order, fill_job, packed_order, previewed, write_order
from magiclens.studio.results import WANTS, job_summary, run_summary
from magiclens.studio.sharing import film_to_share
from magiclens.studio.store import StudioFolder, file_below, sole_user
from magiclens.studio.worker import Worker

MOST_UPLOAD_BYTES = 20_000_000
"""Largest picture that is taken."""
_MOST_JSON_BYTES = 500_000
_SCRIPTS = ("main.js", "orders.js", "crop.js", "preview.js", "jobs.js", "server.js", "tiles.js")
_CARDS = (
    ("single", "single", "One picture", "It appears when the lens lies on its sheet.", 1),
    ("rotating", "rotating", "A picture for each turn", "Turn the lens by a quarter: another one appears.", 1),
    ("multi-view", "multi-view", "A picture for each eye", "Move your head: another one appears.", 2),
    ("universal-animation", "key", "A key for any picture", "One lens, a printed sheet for each picture.", 1),
    ("question-answer", "question-answer", "Question and answer", "A sheet that asks; the lens answers.", 1),
    ("universal-animation", "animation", "An animation", "A screen below the lens plays it, in dots.", 2),
)
"""Cards: scenario, thumbnail, what the lens does, what its owner sees, and fewest pictures that make sense."""
_TYPES = {
    ".html": "text/html", ".png": "image/png", ".json": "application/json", ".pdf": "application/pdf",
    ".yaml": "text/plain", ".webp": "image/webp", ".svg": "image/svg+xml", ".gif": "image/gif", ".mp4": "video/mp4",
}  # fmt: skip
_FILMS = {f"{want}/share.gif": want for want in WANTS}
"""Addresses of films to share, which are made when somebody asks for them."""
_LOOK_S = 0.25


class Studio:
    """The answers of the studio; each method that takes a request is one address."""

    def __init__(self, store: StudioFolder, worker: Worker, door: Door):
        self._store, self._worker, self._door = store, worker, door

    async def page(self, request: Request) -> Response:
        """The one page."""
        response = HTMLResponse(
            render_page(
                "magiclens.studio/studio.html",
                cards=[
                    (name, *words, max(least, LAYOUTS[name].least), LAYOUTS[name].most)
                    for name, *words, least in _CARDS
                ],
                machines={name: _capital(profile.title) for name, profile in machines().items()},
            )
        )
        self._door.enter(request, response)
        return response

    async def script(self, request: Request) -> Response:
        """A module of the page."""
        name = request.path_params["name"]
        if name not in _SCRIPTS:
            raise HTTPException(404)
        return Response(template_text(f"magiclens.studio/{name}"), media_type="text/javascript")

    async def events(self, request: Request) -> Response:
        """The state, now and after every change, as server-sent events."""
        return StreamingResponse(self._changes(), media_type="text/event-stream")

    async def _changes(self) -> AsyncIterator[str]:
        seen = None
        while not self._store.closing:
            if seen != self._store.version:
                seen = self._store.version
                yield f"data: {json.dumps(await run_in_threadpool(self._state))}\n\n"
            await asyncio.sleep(_LOOK_S)

    async def state(self, request: Request) -> Response:
        """The state once, for programs."""
        return JSONResponse(await run_in_threadpool(self._state))

    def _state(self) -> dict[str, Any]:
        with self._store.lock:
            return {
                "pictures": self._store.pictures(),
                "jobs": [job_summary(self._store, job) for job in reversed(self._store.jobs())],
                "bytes": self._store.used_bytes(),
                "kept_bytes": self._store.kept_bytes(),
            }

    async def add_picture(self, request: Request) -> Response:
        """Take a picture: the file is the body, its name in the query."""
        name = request.query_params.get("name", "picture")[:200]
        with self._store.filling() as folder:
            path = folder / "upload"
            path.write_bytes(await _body(request, MOST_UPLOAD_BYTES))
            kept = await run_in_threadpool(self._store.add_picture, name, path)
        return JSONResponse({"name": kept}, 201)

    async def picture(self, request: Request) -> Response:
        """A picture that was uploaded."""
        return _file(self._store.root / "pictures", request.path_params["name"])

    async def delete_picture(self, request: Request) -> Response:
        """Delete a picture."""
        if not self._store.delete_picture(request.path_params["name"]):
            raise HTTPException(404)
        return Response(status_code=204)

    async def preview(self, request: Request) -> Response:
        """A picture as a lens is to show it, and why."""
        asked = request.query_params
        try:
            contrast = float(asked.get("contrast", "0"))
        except ValueError:
            raise InputError("it is a number from 0 to 1", "contrast") from None
        treatment = treatment_of(asked.get("crop", "auto"), contrast, asked.get("ground", "auto"))
        name = request.path_params["name"]
        return JSONResponse(await run_in_threadpool(previewed, name, treatment, self._store))

    async def foreseen(self, request: Request) -> Response:
        """What is known of an order before anything is designed: its facets, and rows of a table."""
        order = await _order(request)
        return JSONResponse(await run_in_threadpool(foreseen, order, self._store))

    async def spec(self, request: Request) -> Response:
        """The YAML of an order, without a job."""
        order = await _order(request)
        return JSONResponse({"yaml": await run_in_threadpool(self._yaml, order)})

    def _yaml(self, order: Order) -> str:
        with self._store.filling() as folder:
            write_order(order, self._store, folder)
            return (folder / SPEC).read_text(encoding="utf-8")

    async def add_job(self, request: Request) -> Response:
        """Queue an order, as a draft first."""
        order = await _order(request)
        job = await run_in_threadpool(self._store.add_job, partial(fill_job, order, self._store))
        self._worker.wake()
        return JSONResponse({"id": job}, 201)

    async def ask(self, request: Request) -> Response:
        """Ask for the draft or the full design of a job, or cancel it."""
        job, what = self._job(request), request.path_params["what"]
        if what == "cancel":
            await run_in_threadpool(self._worker.cancel, job)
        elif what in WANTS:
            await run_in_threadpool(self._worker.ask, job, what)
        else:
            raise HTTPException(404)
        return Response(status_code=204)

    async def delete_job(self, request: Request) -> Response:
        """Delete a job that does not run."""
        job = self._job(request)
        with self._store.lock:
            if self._store.state(job)["state"] == "running":
                raise HTTPException(409, "it is running: cancel it first")
            self._store.delete_job(job)
        return Response(status_code=204)

    async def forget_results(self, request: Request) -> Response:
        """Delete what is kept for later runs."""
        await run_in_threadpool(self._store.forget_results)
        return Response(status_code=204)

    async def job_file(self, request: Request) -> Response:
        """A file in the folder of a job: its spec, also with its pictures, or a file of its runs."""
        job, path = self._job(request), request.path_params["path"]
        if path == PACKED:
            content = await run_in_threadpool(packed_order, self._store.root / "jobs" / job)
            return Response(content, media_type="application/zip")
        if path in _FILMS:
            return await run_in_threadpool(_film, self._store.root / "jobs" / job / _FILMS[path])
        if path != SPEC and path.split("/")[0] not in WANTS:
            raise HTTPException(404)
        return _file(self._store.root / "jobs" / job, path)

    def _job(self, request: Request) -> str:
        job = str(request.path_params["job"])
        if not self._store.job_folder(job):
            raise HTTPException(404)
        return job


def studio_app(store: StudioFolder, worker: Worker, door: Door) -> Starlette:
    """The web app, as ASGI servers and test clients take it; the worker runs as long as it does."""
    studio = Studio(store, worker, door)

    @asynccontextmanager
    async def working(_: Starlette) -> AsyncIterator[None]:
        worker.start()
        try:
            yield
        finally:
            await run_in_threadpool(worker.stop)

    def route(method: str, path: str, answer: Callable[[Request], Any]) -> Route:
        return Route(path, answer, methods=[method])

    routes = [
        route("GET", "/", studio.page),
        route("GET", "/static/{name}", studio.script),
        route("GET", "/api/events", studio.events),
        route("GET", "/api/state", studio.state),
        route("POST", "/api/pictures", studio.add_picture),
        route("DELETE", "/api/pictures/{name}", studio.delete_picture),
        route("GET", "/api/previews/{name}", studio.preview),
        route("POST", "/api/specs", studio.spec),
        route("POST", "/api/forecasts", studio.foreseen),
        route("POST", "/api/jobs", studio.add_job),
        route("POST", "/api/jobs/{job}/{what}", studio.ask),
        route("DELETE", "/api/jobs/{job}", studio.delete_job),
        route("DELETE", "/api/results", studio.forget_results),
        route("GET", "/pictures/{name}", studio.picture),
        route("GET", "/jobs/{job}/{path:path}", studio.job_file),
    ]
    refusals: dict[Any, Any] = {HTTPException: _refused, MagicLensError: _mistaken, OSError: _failed}
    return Starlette(
        routes=routes, middleware=[Middleware(Guard, door=door)], exception_handlers=refusals, lifespan=working
    )


class _Server(uvicorn.Server):
    """A server that ends its streams when it is told to end, as it waits for them."""

    def __init__(self, config: uvicorn.Config, store: StudioFolder):
        super().__init__(config)
        self._store = store

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._store.closing = True
        super().handle_exit(sig, frame)


def serve_studio(folder: Path, port: int, origins: Sequence[str], shown: Callable[[str], None]) -> None:
    """Serve the studio until it is interrupted.

    Args:
        folder: Where everything is kept.
        port: The port on 127.0.0.1; 0 for one that is free.
        origins: Further origins that pages may have, for a reverse proxy.
        shown: Is told the address to open.

    Raises:
        InputError: The port is taken, another studio has the folder, or an origin is none.
    """
    _check_origins(origins)
    with _listening(port) as listener, sole_user(folder):
        door = Door(listener.getsockname()[1], origins)
        store = StudioFolder(folder)
        app = studio_app(store, Worker(store), door)
        config = uvicorn.Config(
            app, log_level="warning", access_log=False, timeout_graceful_shutdown=1, ws="none", proxy_headers=False
        )
        shown(door.address)
        with suppress(KeyboardInterrupt):  # the usual end
            _Server(config, store).run(sockets=[listener])


def _check_origins(origins: Sequence[str]) -> None:
    for origin in origins:
        if not re.fullmatch(r"https?://[\w.-]+(:\d+)?", origin):
            raise InputError(f"'{origin}' is no origin; write one such as https://studio.example.org", "--origin")


def _listening(port: int) -> socket.socket:
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(("127.0.0.1", port))
        listener.listen()  # at once: a browser that is quicker than the server waits instead of being refused
    except (OSError, OverflowError):
        listener.close()
        raise InputError(
            f"port {port} of 127.0.0.1 cannot be had; choose another, or 0 for a free one", "--port"
        ) from None
    return listener


def _capital(title: str) -> str:
    """A title for a list: without its article, with a capital letter."""
    words = re.sub("^an? ", "", title)
    return words[0].upper() + words[1:]


async def _order(request: Request) -> Order:
    try:
        return Order.model_validate_json(await _body(request, _MOST_JSON_BYTES))
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"{'.'.join(map(str, first['loc'])) or 'order'}: {first['msg']}") from None


async def _body(request: Request, most: int) -> bytes:
    """The body of a request; 413 as soon as it is too large."""
    content = bytearray()
    try:
        async for part in request.stream():
            content += part
            if len(content) > most:
                raise HTTPException(413, f"at most {most / 1e6:g} MB are taken")
    except ClientDisconnect:
        raise HTTPException(400, "the upload was broken off") from None
    return bytes(content)


def _film(run: Path) -> Response:
    """A film of a finished run, to share."""
    found = run_summary(run)
    if not found or not all(view["designed"] for view in found["views"]):
        raise HTTPException(404)
    return Response(film_to_share(run, found["views"]), media_type="image/gif")


def _file(folder: Path, relative: str) -> Response:
    found = file_below(folder, relative)
    if not found:
        raise HTTPException(404)
    kind = _TYPES.get(found.suffix)
    headers = {"content-security-policy": RUN_POLICY}
    return FileResponse(
        found,
        headers=headers,
        media_type=kind or "application/octet-stream",
        filename=None if kind else found.name,  # what no page shows is downloaded
    )


def _errors(status: int, errors: list[dict[str, str | None]]) -> Response:
    return JSONResponse({"errors": errors}, status)


async def _refused(request: Request, error: HTTPException) -> Response:
    return _errors(error.status_code, [{"where": None, "message": error.detail}])


async def _mistaken(request: Request, error: MagicLensError) -> Response:
    found = error.mistakes() if isinstance(error, InputError) else [{"where": None, "message": str(error)}]
    return _errors(422, found)


async def _failed(request: Request, error: OSError) -> Response:
    return _errors(500, [{"where": None, "message": f"the studio's folder: {error.strerror or 'cannot be used'}"}])
