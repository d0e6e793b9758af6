"""Movies: frames are read from folders, GIF, APNG, WebP and video files, and written to GIF and MP4 files."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import chain, pairwise
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from magiclens.contract.artifacts import FloatArray, IntArray
from magiclens.contract.errors import InputError
from magiclens.images.colour import grey, to_display, to_linear
from magiclens.images.files import check_ordinary, check_pixels, open_picture, read_image

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer
    from PIL.Image import Image

ByteArray = NDArray[np.uint8]
"""Pictures (H, W, C) of display values 0..255."""

_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".gif", ".svg", ".heic")
"""Suffixes of files in a folder that count as its frames."""
_ANIMATED = ("GIF", "PNG", "WEBP")
"""Pillow's names of formats that can hold several frames."""
_CHOICES = "a folder of images, or a GIF, APNG, MP4, MOV or WebM file"
_VIDEO_OPTIONS = {"format_whitelist": "mov,matroska,avi", "protocol_whitelist": "file"}
"""Options of FFmpeg's reader: a file may not make it open other files or addresses."""

_PALETTE = 256
"""Number of colours of a GIF."""
_SAMPLE_PX = 100_000
"""Number of pixels, roughly, from which the palette of a movie is made."""
_FASTEST_GIF = 50
"""Highest number of frames per second of a GIF; browsers slow down faster ones."""

_MP4_OPTIONS = {"movflags": "+faststart", "fflags": "+bitexact"}
# one thread and "bitexact", so that equal frames give equal bytes
_X264_OPTIONS = {"crf": "16", "preset": "slow", "threads": "1", "flags": "+bitexact"}
_WITHOUT_VERSION = "filter_units=remove_types=6"
"""Filter that drops the notes in which the encoder names itself and its settings, so that equal frames give equal
bytes."""
_BT709, _SRGB_CURVE, _VIDEO_RANGE = 1, 13, 1
"""FFmpeg's numbers of the colours, the curve and the range of values that an MP4 file states."""


def read_frames(path: str | PathLike[str]) -> Iterator[FloatArray]:
    """Read the frames of a movie, each when it is asked for.

    Args:
        path: A folder of images (in natural order: 2 before 10), a GIF, an animated PNG or WebP, or a video file. Its
            values are taken as display values (sRGB); transparent pixels are composited over white paper.

    Returns:
        Frames (H, W, C) float32, linear light; C is 1 where a frame is grey, else 3.

    Raises:
        InputError: There is no such file or a frame cannot be read; at once if that is the first frame.
    """
    frames = _frames(Path(path))
    first = next(frames, None)
    if first is None:
        raise InputError(f"the movie {str(path)!r} has no frames")
    return chain([first], frames)


def is_still(path: str | PathLike[str]) -> bool:
    """Whether a file is a single picture, not a movie or a folder. Raises InputError if it is missing or broken."""
    return not Path(path).is_dir() and _moves(Path(path)) is False


def is_animated(path: str | PathLike[str]) -> bool:
    """Whether a picture file has several frames; False for what is no picture. Raises InputError if it is broken."""
    from PIL import UnidentifiedImageError

    try:
        with open_picture(path) as image:
            return image.format in _ANIMATED and getattr(image, "n_frames", 1) > 1
    except InputError:
        raise
    except UnidentifiedImageError:
        return False
    except Exception as error:  # decoders raise anything on broken files
        raise _unreadable(Path(path), error) from error


def frame_rate(path: str | PathLike[str]) -> float | None:
    """Mean number of frames per second of a movie file; None for a folder, or if the file does not state it."""
    path = Path(path)
    if path.is_dir():
        return None
    if _is_picture(path):
        return _animation_rate(path)
    with _opened(path) as container:
        rate = container.streams.video[0].average_rate
        return float(rate) if rate else None


def write_gif(path: str | PathLike[str], frames: Iterable[FloatArray], fps: float) -> None:
    """Write a GIF that loops forever; equal frames give equal bytes.

    All frames have one palette: all their colours if these are at most 256, as in any grey movie, else an adaptive
    palette, without dithering. Equal successive frames become one that is shown longer.

    Args:
        path: The file.
        frames: (H, W, C) linear light, all of one size.
        fps: Frames per second.

    Raises:
        InputError: ``fps`` is above 50.
        ValueError: There are no frames, or their sizes differ.
    """
    if not 0 < fps <= _FASTEST_GIF:
        raise InputError(f"a GIF cannot show {fps:g} frames per second; use at most {_FASTEST_GIF}, or MP4")
    pictures = [_bytes(frame) for frame in frames]
    _require_one_shape(pictures)
    codes = [_codes(picture) for picture in pictures]
    colours = _distinct(codes)
    palette, index = (colours, np.arange(len(colours))) if len(colours) <= _PALETTE else _adapted(pictures, colours)
    first, *rest = (_indexed(index[np.searchsorted(colours, code)], palette) for code in codes)
    ends = [round(100 * k / fps) for k in range(len(pictures) + 1)]
    milliseconds = [10 * (end - start) for start, end in pairwise(ends)]
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=milliseconds, loop=0, optimize=False)


def write_mp4(path: str | PathLike[str], frames: Iterable[FloatArray], fps: float) -> None:
    """Write an MP4 file with H.264 video; equal frames give equal bytes.

    If a side is odd, the last row or column is repeated, since the format halves the resolution of colour.

    Args:
        path: The file.
        frames: (H, W, C) linear light, all of one size.
        fps: Frames per second.

    Raises:
        ValueError: There are no frames, or their sizes differ.
    """
    import av
    from av.bitstream import BitStreamFilterContext

    pictures = map(_even, map(_bytes, frames))
    first = next(pictures, None)
    if first is None:
        raise ValueError("a movie needs at least one frame")
    with av.open(str(path), "w", format="mp4", options=_MP4_OPTIONS) as container:
        stream = container.add_stream("libx264", Fraction(fps).limit_denominator(1001), _X264_OPTIONS)
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.colorspace, context.color_primaries, context.color_range = _BT709, _BT709, _VIDEO_RANGE
        context.color_trc = _SRGB_CURVE
        anonymous = BitStreamFilterContext(_WITHOUT_VERSION, stream)
        for picture in chain([first], pictures):
            _require_one_shape([first, picture])
            for packet in stream.encode(_video_frame(picture)):
                container.mux(anonymous.filter(packet))
        for packet in stream.encode(None):
            container.mux(anonymous.filter(packet))
        container.mux(anonymous.filter(None))


# Reading


def _frames(path: Path) -> Iterator[FloatArray]:
    """The frames of a folder or a file."""
    if path.is_dir():
        return _folder_frames(path)
    return _animation_frames(path) if _is_picture(path) else _video_frames(path)


def _folder_frames(folder: Path) -> Iterator[FloatArray]:
    """The images of a folder, without hidden files."""
    names = [p.name for p in folder.iterdir() if p.suffix.lower() in _PICTURES and not p.name.startswith(".")]
    if not names:
        raise InputError(f"the folder {str(folder)!r} holds no images")
    for name in sorted(names, key=_natural):
        yield read_image(folder / name)


def _natural(name: str) -> tuple[list[str | int], str]:
    """A key that sorts names naturally: numbers in them by their value."""
    parts = re.split(r"(\d+)", name.lower())
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], name


def _is_picture(path: Path) -> bool:
    """Whether a file is an animated picture; if not, it may be a video.

    Raises InputError if it is missing or a single picture.
    """
    moves = _moves(path)
    if moves is False:
        raise InputError(f"{str(path)!r} is a single picture, not a movie; use {_CHOICES}")
    return moves is not None


def _moves(path: Path) -> bool | None:
    """Whether a picture file is animated; None if it is not a picture. Raises InputError if it is missing or broken."""
    from PIL import UnidentifiedImageError

    check_ordinary(path, "movie file or folder")
    try:
        with open_picture(path) as image:
            return image.format == "GIF" or (image.format in _ANIMATED and getattr(image, "is_animated", False))
    except InputError:
        raise
    except UnidentifiedImageError:
        return None
    except Exception as error:
        raise _unreadable(path, error) from error


def _animation_frames(path: Path) -> Iterator[FloatArray]:
    """All frames of an animated picture, each composited over those before it."""
    from PIL import ImageSequence

    try:
        with open_picture(path) as image:
            for frame in ImageSequence.Iterator(image):
                yield _light(np.asarray(frame.convert("RGBA")))
    except Exception as error:  # decoders raise anything on broken files
        raise _unreadable(path, error) from error


def _animation_rate(path: Path) -> float | None:
    """Frames per second of an animated picture."""
    from PIL import ImageSequence

    try:
        with open_picture(path) as image:
            milliseconds = [_milliseconds(frame) for frame in ImageSequence.Iterator(image)]
    except Exception as error:
        raise _unreadable(path, error) from error
    return 1000 * len(milliseconds) / sum(milliseconds) if sum(milliseconds) else None


def _milliseconds(frame: Image) -> float:
    """How long a frame is shown; 0 if the file does not state it."""
    frame.load()  # Pillow reads the duration of a WebP frame only with its pixels
    return float(frame.info.get("duration", 0))


def _video_frames(path: Path) -> Iterator[FloatArray]:
    """All frames of a video file, upright."""
    from av import FFmpegError

    with _opened(path) as container:
        try:
            for frame in container.decode(video=0):
                values = np.asarray(frame.to_ndarray(format="rgb24"))
                yield _light(np.rot90(values, round(frame.rotation / 90)))
        except FFmpegError as error:
            raise _unreadable(path, error) from error


def _opened(path: Path) -> InputContainer:
    """A video file, opened. Raises InputError if it cannot be read or has no pictures, such as a sound file."""
    import av

    try:
        container = av.open(str(path), options=_VIDEO_OPTIONS)
    except (av.FFmpegError, OSError):
        raise InputError(f"{str(path)!r} is not a movie that can be read; use {_CHOICES}") from None
    if not container.streams.video:
        container.close()
        raise InputError(f"{str(path)!r} holds no moving picture")
    check_pixels((container.streams.video[0].width, container.streams.video[0].height), str(path))
    return container


def _unreadable(path: Path, error: Exception) -> InputError:
    """The error to raise when a decoder fails."""
    return InputError(f"the movie {str(path)!r} cannot be read: {error}")


def _light(values: ByteArray) -> FloatArray:
    """(H, W, 1 or 3) linear light of (H, W, 3 or 4) bytes; the fourth is alpha, composited over white paper."""
    shares = values.astype(np.float32) / np.float32(255)
    light = to_linear(shares[..., :3])
    if values.shape[-1] == 4:
        light = light * shares[..., 3:] + (1 - shares[..., 3:])
    return np.ascontiguousarray(grey(light), dtype=np.float32)


# Writing


def _bytes(linear: FloatArray) -> ByteArray:
    """(H, W, 3) display values 0..255."""
    values = np.rint(to_display(linear) * 255).astype(np.uint8)
    return np.broadcast_to(values, (*values.shape[:2], 3))


def _require_one_shape(pictures: Sequence[ByteArray]) -> None:
    """Raise ValueError unless there is at least one picture and all have the same size."""
    shapes = sorted({picture.shape[:2] for picture in pictures})
    if len(shapes) != 1:
        raise ValueError(f"a movie needs frames of one size, not {shapes}")


def _even(picture: ByteArray) -> ByteArray:
    """The picture, with the last row or column repeated if a side is odd."""
    rows, columns = picture.shape[:2]
    return np.pad(picture, ((0, rows % 2), (0, columns % 2), (0, 0)), mode="edge")


def _video_frame(picture: ByteArray) -> VideoFrame:
    """A frame of luminance and, at half the resolution, colour differences, made of a picture (H, W, 3)."""
    from av import VideoFrame

    frame = VideoFrame.from_ndarray(picture, "rgb24")
    return frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG", threads=1)


def _codes(picture: ByteArray) -> IntArray:
    """(H, W) colour codes, 65536 red + 256 green + blue, of a picture (H, W, 3)."""
    codes: IntArray = picture.astype(np.int32) @ np.array([65536, 256, 1], np.int32)
    return codes


def _distinct(codes: Sequence[IntArray]) -> IntArray:
    """The colour codes that occur, sorted."""
    occurs = np.zeros(1 << 24, bool)
    for code in codes:
        occurs[code] = True
    return np.flatnonzero(occurs)


def _channels(codes: IntArray) -> ByteArray:
    """(n, 3) bytes of colour codes."""
    return np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=-1).astype(np.uint8)


def _adapted(pictures: Sequence[ByteArray], colours: IntArray) -> tuple[IntArray, IntArray]:
    """An adaptive palette as colour codes, and for each of ``colours`` the index of its nearest one in the palette."""
    from PIL import Image
    from scipy.spatial import KDTree

    step = max(sum(picture[..., 0].size for picture in pictures) // _SAMPLE_PX, 1)
    sample = np.concatenate([picture.reshape(-1, 3)[::step] for picture in pictures])
    reduced = Image.fromarray(sample[None]).quantize(_PALETTE, Image.Quantize.MEDIANCUT, kmeans=1)
    palette = np.array(reduced.getpalette(), np.uint8).reshape(-1, 3)
    nearest = KDTree(palette).query(_channels(colours))[1]
    return _codes(palette[None])[0], np.asarray(nearest)


def _indexed(index: IntArray, palette: IntArray) -> Image:
    """A palette image of (H, W) indices."""
    from PIL import Image

    image = Image.fromarray(index.astype(np.uint8))
    image.putpalette(_channels(palette).tobytes())
    return image
