"""Matching: every offset of a window compared with every tile; the best offset of each part of the window is kept."""

from __future__ import annotations

import argparse
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

from benchmarks.comparison import Comparison, installed, require
from magiclens.contract.artifacts import FloatArray

_PIXELS, _OFFSETS, _PARTS = 8, 100, 6
"""Pixels along a tile's side, offsets along the window's, and its parts along it: 36 candidates per tile."""
_CROP = 300


def comparisons(options: argparse.Namespace) -> list[Comparison]:
    """Against OpenCV in two threads, and against all sums computed; FAISS is given fewer tiles, for it takes long."""
    sides = (6, 3) if options.quick else (128, 16)
    found = []
    for side, peers in zip(sides, ({"OpenCV matchTemplate, 2 threads": opencv}, {"every sum": every_sum}), strict=True):
        source, target = mosaic(_PIXELS * side + _OFFSETS - 1, (0, 1, 2, 3)), mosaic(_PIXELS * side, (2, 3, 1, 0))
        task = f"{side}² tiles of {_PIXELS}x{_PIXELS}x3, {_OFFSETS}² offsets, best of {_PARTS}² parts of the window"
        work = {name: (lambda peer=peer, s=source, t=target: peer(s, t)) for name, peer in peers.items()}
        if peers.get("every sum") and installed("faiss"):
            work["FAISS, exact, a window's patches at a time"] = lambda s=source, t=target: faiss_flat(s, t)
        missing = () if installed("faiss") else ("FAISS",)
        ours = lambda s=source, t=target: search_window(s, t)  # noqa: E731
        found.append(Comparison("matching", task, ours, work, sums_agree, missing))
    return found


def mosaic(side: int, order: tuple[int, ...]) -> FloatArray:
    """(side, side, 3) float32 display values: crops of four photographs, side by side."""
    from skimage import data

    photographs = [data.astronaut(), data.coffee(), data.rocket(), data.chelsea()]
    crops = [p[:_CROP, -_CROP:].astype(np.float32) / 255 for p in photographs]
    per_side = -(-side // _CROP)
    rows = [np.concatenate([crops[order[(i + 2 * j) % 4]] for i in range(per_side)], axis=1) for j in range(per_side)]
    return np.ascontiguousarray(np.concatenate(rows)[:side, :side])


def parts() -> FloatArray:
    """(parts,) which offset is the first of each part of the window."""
    half = 0.5 * _OFFSETS - 0.25
    bucket = ((np.arange(_OFFSETS) - 0.5 * (_OFFSETS - 1) + half) / (2 * half) * _PARTS).astype(int)
    return np.searchsorted(bucket, np.arange(_PARTS))


def tiles_of(target: FloatArray) -> FloatArray:
    """(F, P, P, 3) the tiles of a target, row by row."""
    n = len(target) // _PIXELS
    return target.reshape(n, _PIXELS, n, _PIXELS, 3).swapaxes(1, 2).reshape(-1, _PIXELS, _PIXELS, 3)


def search_window(source: FloatArray, target: FloatArray) -> FloatArray:
    """(F, parts^2) least sums of squared differences, by the search of the ``exhaustive`` matcher."""
    from magiclens.matching.exhaustive_kernels import search
    from magiclens.matching.features import choose_basis
    from magiclens.matching.pool import Pool
    from magiclens.matching.raster_kernels import patch_features
    from magiclens.matching.rasters import Raster
    from magiclens.matching.tuples import Tiles, Window
    from magiclens.optics.medium import Optics

    plain = np.ascontiguousarray(source.transpose(2, 0, 1))
    samples = plain[:, None]
    basis = choose_basis(samples, 1, _PIXELS)
    features = patch_features(samples, 1, (1, 1), basis)
    values = np.ascontiguousarray(tiles_of(target).transpose(0, 3, 1, 2))
    n = len(target) // _PIXELS
    at = (np.arange(n) + 0.5 - n / 2) * _PIXELS
    centres = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    raster = Raster(samples, basis, features, 1.0, 1.0, 1.0, 1.0, plain.shape[2], plain.shape[1], 1, 1, 1, 1)
    # offsets of one pixel in a window of 100; a step of next to nothing makes the distance term nothing
    window = Window(0.5 * _OFFSETS - 0.25, 1e-9, _PARTS)
    # an eye so far above that a slab so thick can show every patch
    optics = Optics(np.array([0.0, 0.0, 1e6]), False, 1e5, 0.0, 1.49, -1.0, 1e6)
    pool = Pool(len(values), _PARTS)
    search(Tiles(values, centres, float(_PIXELS)), raster, window, False, optics, pool.found)
    return pool.errors * np.float32(values[0].size)


def opencv(source: FloatArray, target: FloatArray) -> FloatArray:
    """The same by OpenCV, a tile at a time, in two threads."""
    import cv2

    cv2.setNumThreads(1)  # tiles are small: threads of ours, each with tiles of its own, are faster than OpenCV's
    n, wide, first = len(target) // _PIXELS, _OFFSETS - 1 + _PIXELS, parts()
    tiles = tiles_of(target)

    def best(f: int) -> FloatArray:
        y, x = (_PIXELS * k for k in divmod(f, n))
        sums = cv2.matchTemplate(source[y : y + wide, x : x + wide], tiles[f], cv2.TM_SQDIFF)
        return np.minimum.reduceat(np.minimum.reduceat(sums, first, 0), first, 1).ravel()

    with ThreadPoolExecutor(2) as pool:
        return np.array(list(pool.map(best, range(len(tiles)))))


def every_sum(source: FloatArray, target: FloatArray) -> FloatArray:
    """The same by computing every sum, compiled, in two threads."""
    from magiclens.kernels.threads import in_threads

    tiles, first = tiles_of(target), parts()
    sums = np.zeros((len(tiles), _OFFSETS, _OFFSETS), np.float32)
    in_threads(_all_sums(), len(tiles), np.ascontiguousarray(source.transpose(2, 0, 1)), tiles, sums)
    least = np.minimum.reduceat(np.minimum.reduceat(sums, first, 1), first, 2)
    return least.reshape(len(tiles), -1)


_compiled = []


def _all_sums():  # type: ignore[no-untyped-def]
    """The kernel that computes every sum, compiled once."""
    import numba

    if not _compiled:

        @numba.njit(nogil=True, fastmath=True)
        def kernel(part, source, tiles, sums):  # type: ignore[no-untyped-def]
            n = source.shape[1] - sums.shape[1] + 1
            per_row, pixels = n // tiles.shape[1], tiles.shape[1]
            for f in range(part.first, part.end):
                y, x = (f // per_row) * pixels, (f % per_row) * pixels
                for j in range(sums.shape[1]):
                    for c in range(3):
                        for ky in range(pixels):
                            for kx in range(pixels):
                                t = tiles[f, ky, kx, c]
                                for i in range(sums.shape[2]):
                                    d = t - source[c, y + j + ky, x + i + kx]
                                    sums[f, j, i] += d * d

        _compiled.append(kernel)
    return _compiled[0]


def faiss_flat(source: FloatArray, target: FloatArray) -> FloatArray:
    """The same by FAISS: the patches of each part of a tile's window, as vectors, and the nearest of them."""
    import faiss

    n, wide, first = len(target) // _PIXELS, _OFFSETS - 1 + _PIXELS, [*parts(), _OFFSETS]
    found = []
    for f, tile in enumerate(tiles_of(target)):
        y, x = (_PIXELS * k for k in divmod(f, n))
        window = source[y : y + wide, x : x + wide]
        patches = np.lib.stride_tricks.sliding_window_view(window, (_PIXELS, _PIXELS), (0, 1))
        query = np.ascontiguousarray(tile.transpose(2, 0, 1).reshape(1, -1))
        for a, b in pairwise(first):
            for c, d in pairwise(first):
                rows = np.ascontiguousarray(patches[a:b, c:d]).reshape(-1, query.size)
                found.append(faiss.knn(query, rows, 1)[0][0, 0])
    return np.array(found, np.float32).reshape(-1, _PARTS * _PARTS)


def sums_agree(ours: FloatArray, theirs: FloatArray) -> str:
    """Sums of squares are equal, but for how 192 float32 are added up; OpenCV multiplies out the square."""
    worst = float(np.abs(ours - theirs).max())
    return require(
        worst < 1e-3 * float(theirs.max()), f"sums equal to {worst / float(theirs.max()):.0e} of the largest"
    )
