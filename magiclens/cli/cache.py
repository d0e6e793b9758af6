"""The command that shows, checks and shrinks what earlier runs have kept: ``mlens cache``."""

from __future__ import annotations

import time
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from magiclens.cli.common import AsJson, Traceback, print_result, reporting

if TYPE_CHECKING:
    from magiclens.cache.store import Cache


class CacheAction(StrEnum):
    """What ``mlens cache`` can do."""

    ls = "ls"
    gc = "gc"
    verify = "verify"


def cache_command(
    action: Annotated[
        CacheAction, typer.Argument(help="List results; remove the oldest; check all.", show_default=False)
    ],
    size: Annotated[
        str | None,
        typer.Option(
            "--size", metavar="SIZE", help="For gc: how much may stay, such as 500MB.", show_default="the limit"
        ),
    ] = None,
    as_json: AsJson = False,
    traceback: Traceback = False,
) -> None:
    """List, shrink or check what runs have kept. MLENS_CACHE_DIR says where it is, MLENS_CACHE_SIZE how large at most.

    Exit code 1: something was damaged; it has been removed and will be made again.
    """
    with reporting(traceback):
        from magiclens.cache.folder import most_bytes, results_folder, size_in_bytes
        from magiclens.cache.store import Cache

        cache = Cache(results_folder(), most_bytes())
        if action is CacheAction.ls:
            print_result(lambda: _list_text(cache), lambda: _list_data(cache), as_json=as_json)
        elif action is CacheAction.gc:
            wanted = None if size is None else size_in_bytes(size, "--size")
            freed = sum(kept.size_bytes for kept in cache.make_room(wanted))
            print_result(
                lambda: _room_text(cache, freed), lambda: {"freed_bytes": freed, **_sizes(cache)}, as_json=as_json
            )
        else:
            damaged = cache.verify()
            text = "\n".join([*damaged, f"{len(damaged)} damaged; {len(cache.files())} files are as they were written"])
            print_result(lambda: text, lambda: {"damaged": damaged, **_sizes(cache)}, as_json=as_json)
            if damaged:
                raise typer.Exit(1)


def _list_text(cache: Cache) -> str:
    """A line for each result, those used last first, and what all of them take."""
    from magiclens.cache.folder import size_text

    lines = [f"{'STEP':40}{'TOOK':>10}{'USED':>14}{'SIZE':>10}  KEY"]
    for each in _results(cache):
        used, size = _ago(each["used"]), size_text(each["bytes"])
        lines.append(f"{each['step']:40}{each['seconds']:>8.1f} s{used:>14}{size:>10}  {each['key'][:12]}")
    return "\n".join([*lines, "", _room_text(cache)])


def _list_data(cache: Cache) -> dict[str, Any]:
    return {"results": _results(cache), **_sizes(cache)}


def _results(cache: Cache) -> list[dict[str, Any]]:
    """Of each result its step, key, seconds, bytes without the files that it names, and when it was used."""
    found = [(entry, cache.used(entry.key)) for entry in cache.entries()]
    return [
        {"step": e.step, "key": e.key, "seconds": e.seconds, "bytes": kept.size_bytes, "used": kept.used}
        for e, kept in found
        if kept
    ]


def _sizes(cache: Cache) -> dict[str, Any]:
    files = cache.files()
    taken = sum(kept.size_bytes for kept in files)
    return {"folder": str(cache.folder), "files": len(files), "bytes": taken, "limit_bytes": cache.limit_bytes}


def _room_text(cache: Cache, freed: int | None = None) -> str:
    from magiclens.cache.folder import size_text

    found = _sizes(cache)
    room = (
        f"{found['folder']}: {found['files']} files, {size_text(found['bytes'])} of {size_text(found['limit_bytes'])}"
    )
    return room if freed is None else f"{size_text(freed)} removed\n{room}"


def _ago(seconds: float) -> str:
    """How long ago something was, in the unit that suits it."""
    past = max(time.time() - seconds, 0.0)
    count, unit = next(
        (past / size, unit)
        for size, unit in ((86400, "d"), (3600, "h"), (60, "min"), (1, "s"))
        if past >= size or size == 1
    )
    return f"{count:.0f} {unit} ago"
