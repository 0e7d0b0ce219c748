"""Frames from a folder of pictures or a video, in capture order, decoded one at a time.

Everything that can be known without decoding (names, sizes, stamps) is checked when the source is opened. Pictures are
decoded by Pillow because it refuses a cut-off file where OpenCV would return a half-grey picture; orientation tags
are ignored, a camera's calibration being in its sensor's own axes. Of a thermal camera's R-JPEG the counts are taken,
and not the palette that it is shown in.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from contract.camera import Camera
from contract.errors import InputError
from onboard.camera.file_stamps import (
    read_stamps,
    spread_within_seconds,
    stamp_from_exif,
    stamp_from_name,
    stamps_of_frames,
)
from onboard.camera.pixel_formats import UNDECODABLE, reduce_16_bit
from onboard.camera.radiometric_jpeg import counts_of, radiometric
from onboard.camera.thermal_grey import ThermalGrey, refuse_palette
from onboard.camera.video_times import dropped_note, frame_times_s
from onboard.events.types import Frame

PICTURE_SUFFIXES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".pnm", ".webp", ".jp2"}
SIXTEEN_BIT_MODES = {"I;16", "I;16B", "I;16L", "I"}
SAME_S = 5e-4  # of two times of one frame
# Frames at a video's end that it has and no decoder shows: of one that was cut by an edit list, those that others are
# decoded from (H.264 and H.265 keep 16 at most).
MOST_UNSHOWN = 16
SIXTEEN_BIT_VIDEO = int.from_bytes(b"Y1\0\x10", "little")  # FFmpeg's gray16le, as OpenCV names it
Raw = NDArray[np.uint8] | NDArray[np.uint16]
WITHOUT_FFMPEG = Path(cv2.__file__).parent / "WITHOUT_FFMPEG"  # there if FFmpeg was left out (packaging/slim.py)


class FrameSource(Protocol):
    """Pictures of one camera with their capture times."""

    @property
    def stamps_ns(self) -> list[int]:
        """Capture times in order, one a frame, strictly increasing."""

    @property
    def names(self) -> list[str]:
        """The name of each frame, in the same order."""

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes for the operator on how they were read, one line each."""

    def frames(self) -> Iterator[Frame]:
        """Each picture in capture order; raises InputError at one that cannot be decoded or has another size."""


def open_frames(
    path: Path | str,
    camera: Camera,
    stamps: Path | str | None = None,
    latency_s: float = 0.0,
    whole_seconds: bool = False,
    epoch_ns: int | None = None,
    max_rate_hz: float = math.inf,
    in_colour: bool = False,
    is_thermal: bool = False,
    black_hot: bool = False,
) -> FrameSource:
    """Open a folder of pictures or a video; `latency_s` is taken off every stamp to give mid-exposure.

    `whole_seconds`: EXIF times cut to the second may serve. `epoch_ns`: when a video without `stamps` began, whatever
    its name states. `max_rate_hz`: pictures closer together are left out. `in_colour`: frames have their colours too.
    `is_thermal`: they have their counts, `black_hot`: turned round, of 8 bits.

    Raises InputError, one line, if it is missing or empty, of another size than the camera, or has no capture times.
    """
    path = Path(path)
    if path.is_dir():
        return PictureFolder(
            path, camera, stamps, latency_s, whole_seconds, max_rate_hz, in_colour, is_thermal, black_hot
        )
    if not path.exists():
        raise InputError(f"frames {path}: no such folder or video")
    if path.suffix.lower() in PICTURE_SUFFIXES:
        raise InputError(f"frames {path}: a single picture; name the folder it is in, or a video")
    return Video(path, camera, stamps, latency_s, epoch_ns, max_rate_hz, in_colour, is_thermal, black_hot)


def _check_size(what: str, size_px: tuple[int, int], camera: Camera) -> None:
    if size_px != camera.size_px:
        raise InputError(
            f"{what} is {size_px[0]} x {size_px[1]}, the camera file states {camera.width_px} x {camera.height_px}"
        )


@dataclass(frozen=True)
class _Stamped:
    stamp_ns: int
    name: str


def _in_capture_order(where: object, stamped: list[_Stamped]) -> list[_Stamped]:
    ordered = sorted(stamped, key=lambda item: (item.stamp_ns, item.name))
    for earlier, later in itertools.pairwise(ordered):
        if earlier.stamp_ns == later.stamp_ns:
            raise InputError(
                f"frames {where}: {earlier.name} and {later.name} have the same capture time, "
                f"{later.stamp_ns / 1e9:.6f} s; each picture needs its own"
            )
    return ordered


def _thinned(stamped: list[_Stamped], max_rate_hz: float) -> list[_Stamped]:
    """Return the pictures in order of time, and of those closer together than the rate allows the first.

    A tenth less counts as no closer.
    """
    out: list[_Stamped] = []
    for item in stamped:
        if not out or (item.stamp_ns - out[-1].stamp_ns) / 1e9 >= 0.9 / max_rate_hz:
            out.append(item)
    return out


def _without_picture(stamped: list[_Stamped], numbers: Mapping[str, int]) -> Iterator[Frame]:
    """Frames that have a number, and that no decoder shows."""
    return (Frame(item.stamp_ns, numbers[item.name], None, item.name) for item in stamped if item.name in numbers)


class PictureFolder:
    """The pictures of one folder (not of its subfolders)."""

    def __init__(
        self,
        folder: Path,
        camera: Camera,
        stamps: Path | str | None,
        latency_s: float,
        whole_seconds: bool = False,
        max_rate_hz: float = math.inf,
        in_colour: bool = False,
        is_thermal: bool = False,
        black_hot: bool = False,
    ) -> None:
        self.folder, self.camera, self._whole_seconds = folder, camera, whole_seconds
        self._in_colour, self._is_thermal, self._black_hot = in_colour, is_thermal, black_hot
        names = sorted(
            entry.name for entry in folder.iterdir() if entry.suffix.lower() in PICTURE_SUFFIXES and entry.is_file()
        )
        if not names:
            raise InputError(f"frames {folder}: no picture in it ({', '.join(sorted(PICTURE_SUFFIXES))})")
        exif = [self._check_header(name, has_stamps=stamps is not None) for name in names]
        if stamps is not None:
            found = self._from_csv(names, stamps)
        else:
            found = self._from_pictures(names, self._whole_in_order(names, exif))
        late_ns = round(latency_s * 1e9)
        stamped = [_Stamped(stamp - late_ns, name) for name, stamp in zip(names, found, strict=True)]
        self._stamped = _thinned(_in_capture_order(folder, stamped), max_rate_hz)

    def _check_header(self, name: str, has_stamps: bool) -> int | None:
        """Check a picture's size; returns its EXIF capture time, if it has one and no table has it.

        A PNG's EXIF may lie behind its pixels, which have to be decoded for it.
        """
        try:
            with Image.open(self.folder / name) as image:
                counted = radiometric(image)
                size_px = image.size if counted is None else counted[1]
                _check_size(f"frames {self.folder}: {name}", size_px, self.camera)
                return None if has_stamps else stamp_from_exif(image, self._whole_seconds)
        except UNDECODABLE as error:
            raise self._undecodable(name, error) from error

    def _whole_in_order(self, names: list[str], exif: list[int | None]) -> list[int | None]:
        """Pictures of one second, where times are cut to it, spread over it in the order of their names."""
        known = sorted((stamp, name) for stamp, name in zip(exif, names, strict=True) if stamp is not None)
        if not self._whole_seconds or len(known) < len(names) or any(stamp % 1_000_000_000 for stamp, _ in known):
            return exif
        spread = spread_within_seconds([stamp for stamp, _ in known])
        by_name = {name: stamp for (_, name), stamp in zip(known, spread, strict=True)}
        return [by_name[name] for name in names]

    def _undecodable(self, name: str, error: Exception) -> InputError:
        why = " ".join(str(error).split()).replace(str(self.folder / name), name)
        return InputError(f"frames {self.folder}: {name} cannot be decoded ({why})")

    def _from_csv(self, names: list[str], path: Path | str) -> list[int]:
        stamps = read_stamps(path, "file")
        by_name = {Path(name).name: stamp for name, stamp in stamps.items()}
        if len(by_name) < len(stamps):
            raise InputError(f"stamps {path}: two entries name the same picture in different folders")
        unknown = sorted(set(by_name) - set(names))
        if unknown:
            raise InputError(f"stamps {path}: '{unknown[0]}' is not a picture in {self.folder}")
        missing = [name for name in names if name not in by_name]
        if missing:
            raise InputError(
                f"stamps {path}: no stamp for {missing[0]}" + (f" and {len(missing) - 1} more" * (len(missing) > 1))
            )
        return [by_name[name] for name in names]

    def _from_pictures(self, names: list[str], exif: list[int | None]) -> list[int]:
        """All by EXIF or all by name: two clocks must not be mixed."""
        from_name = [stamp_from_name(name) for name in names]
        for source in (exif, from_name):
            known = [stamp for stamp in source if stamp is not None]
            if len(known) == len(names):
                return known
        without = names[from_name.index(None)]
        raise InputError(
            f"frames {self.folder}: no capture time for {without}: no EXIF DateTimeOriginal with SubSecTimeOriginal "
            f"and no UTC time in its name; give --stamps, or, for times cut to the second, camera.latency_s = -0.5 and "
            f"camera.sigma_jitter_s = 0.3"
        )

    @property
    def stamps_ns(self) -> list[int]:
        return [item.stamp_ns for item in self._stamped]

    @property
    def names(self) -> list[str]:
        return [item.name for item in self._stamped]

    @property
    def notes(self) -> tuple[str, ...]:
        """None: each picture has its own time."""
        return ()

    def frames(self) -> Iterator[Frame]:
        """Decode and yield each picture; raises InputError at one that cannot be decoded."""
        thermal = ThermalGrey(self._black_hot) if self._is_thermal else None
        for index, item in enumerate(self._stamped):
            try:
                if thermal is not None and index == 0 and (shown := read_colour(self.folder / item.name)) is not None:
                    refuse_palette(shown, f"frames {self.folder}: {item.name}")
                raw = _read_raw(self.folder / item.name)
                colour = read_colour(self.folder / item.name) if self._in_colour else None
            except UNDECODABLE as error:
                raise self._undecodable(item.name, error) from error
            image, counts = (_grey_of(raw), None) if thermal is None else thermal.picture(raw)
            yield Frame(item.stamp_ns, index, image, item.name, colour=colour, counts=counts)


def read_grey(path: Path) -> NDArray[np.uint8]:
    """A picture file as grey (H, W); raises one of `UNDECODABLE`."""
    return _grey_of(_read_raw(path))


def _grey_of(raw: Raw) -> NDArray[np.uint8]:
    return reduce_16_bit(raw.astype(np.uint16)) if raw.dtype == np.uint16 else raw.astype(np.uint8, copy=False)


def _read_raw(path: Path) -> Raw:
    """A picture file (H, W): what has sixteen bits as it is, anything else as grey; raises one of `UNDECODABLE`."""
    with Image.open(path) as image:
        if (counts := counts_of(image)) is not None:
            return counts
        if image.mode in SIXTEEN_BIT_MODES:
            return np.asarray(image).clip(0, 65535).astype(np.uint16)
        image.draft("L", image.size)  # a JPEG's own luma, without the way through colour
        return np.array(image.convert("L"), np.uint8)


def read_colour(path: Path) -> NDArray[np.uint8] | None:
    """A picture file's colours, blue first (H, W, 3), in the sensor's axes as `read_grey`; None if it has none."""
    with Image.open(path) as image:
        if image.mode not in ("RGB", "RGBA", "CMYK", "P") or radiometric(image) is not None:
            return None
        return np.ascontiguousarray(np.array(image.convert("RGB"), np.uint8)[:, :, ::-1])


class Video:
    """A video file; its stamps come from a CSV by index, or from when it began and its container's own frame times."""

    def __init__(
        self,
        path: Path,
        camera: Camera,
        stamps: Path | str | None,
        latency_s: float,
        epoch_ns: int | None = None,
        max_rate_hz: float = math.inf,
        in_colour: bool = False,
        is_thermal: bool = False,
        black_hot: bool = False,
    ) -> None:
        self.path, self.camera = path, camera
        self._in_colour, self._is_thermal, self._black_hot = in_colour, is_thermal, black_hot
        capture = self._open()
        size = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        count, rate_hz = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), capture.get(cv2.CAP_PROP_FPS)
        capture.release()
        _check_size(f"frames {path}", size, camera)
        if count < 1:
            raise InputError(f"frames {path}: the video does not state how many frames it has; remux it")
        self.notes: tuple[str, ...] = ()
        self._times_s = frame_times_s(path)  # the container's own, if it has any
        count = len(self._times_s) or count
        self.last_s = self._times_s[-1] if self._times_s else (count - 1) / rate_hz if rate_hz > 0.0 else 0.0
        self.end_s = self.last_s + (1.0 / rate_hz if rate_hz > 0.0 else 0.0)
        found = (
            stamps_of_frames(stamps, count, self.path.name)
            if stamps is not None
            else self._from_container(count, rate_hz, epoch_ns)
        )
        late_ns = round(latency_s * 1e9)
        names = [f"{path.name}#{index}" for index in range(len(found))]
        stamped = [_Stamped(stamp - late_ns, name) for stamp, name in zip(found, names, strict=True)]
        if _in_capture_order(path, stamped) != stamped:
            raise InputError(f"stamps {stamps}: times must increase with the index")
        self._all, self._stamped = stamped, _thinned(stamped, max_rate_hz)

    def _open(self) -> cv2.VideoCapture:
        if WITHOUT_FFMPEG.is_file():  # OpenCV would call what is not there
            raise InputError(
                f"frames {self.path}: the Debian package reads no videos; install from the sources (README), "
                "or a folder of pictures"
            )
        capture = cv2.VideoCapture(str(self.path))
        if not capture.isOpened():
            raise InputError(f"frames {self.path}: not a video that can be decoded")
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        if int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) == SIXTEEN_BIT_VIDEO:
            capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)  # which would leave the upper eight
        return capture

    def _from_container(self, count: int, rate_hz: float, epoch_ns: int | None) -> list[int]:
        start_ns = stamp_from_name(self.path.name) if epoch_ns is None else epoch_ns
        if start_ns is None or not 0.01 < rate_hz < 1000.0:
            raise InputError(f"frames {self.path}: no capture times: give --stamps with index,unix_time_s")
        if self._times_s:
            self.notes = tuple(filter(None, [dropped_note(self._times_s)]))
            return [start_ns + round((time_s - self._times_s[0]) * 1e9) for time_s in self._times_s]
        self.notes = (
            f"{self.path.name} has no frame times of its own: its frames are taken {rate_hz:g} times a second, which "
            "is wrong where any was dropped; if so, give --stamps",
        )
        return [start_ns + round(index / rate_hz * 1e9) for index in range(count)]

    @property
    def stamps_ns(self) -> list[int]:
        return [item.stamp_ns for item in self._stamped]

    @property
    def names(self) -> list[str]:
        """`clip.mp4#12` for the frame with index 12."""
        return [item.name for item in self._stamped]

    def frames(self) -> Iterator[Frame]:
        """Decode and yield each picture; raises InputError where the video ends too early.

        By the container's times a frame that the decoder leaves out, also at the end, has no picture, and moves no
        other's stamp.
        """
        numbers = {item.name: number for number, item in enumerate(self._stamped)}
        last = self._all.index(self._stamped[-1])
        capture, index = self._open(), 0
        thermal = ThermalGrey(self._black_hot) if self._is_thermal else None
        try:
            while index <= last:
                if not capture.grab():
                    if index == 0 or len(self._all) - index > MOST_UNSHOWN:
                        raise InputError(f"frames {self.path}: frame {index} of {len(self._all)} cannot be decoded")
                    yield from _without_picture(self._all[index:], numbers)
                    return
                shown = self._place_of(float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3, index)
                yield from _without_picture(self._all[index:shown], numbers)
                item, index = self._all[shown], shown + 1
                if item.name in numbers:
                    yield self._frame(capture, item, numbers[item.name], thermal)
        finally:
            capture.release()

    def _frame(self, capture: cv2.VideoCapture, item: _Stamped, number: int, thermal: ThermalGrey | None) -> Frame:
        """The frame that was grabbed last, decoded."""
        got, picture = capture.retrieve()
        if not got or picture is None:
            raise InputError(f"frames {self.path}: {item.name} of {len(self._all)} frames cannot be decoded")
        picture = picture[..., 0] if picture.shape[2:] == (1,) else picture
        raw: Raw = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture  # type: ignore[assignment]
        _check_size(f"frames {self.path}: {item.name}", (raw.shape[1], raw.shape[0]), self.camera)
        if thermal is not None and number == 0 and picture.ndim == 3:
            refuse_palette(np.asarray(picture, np.uint8), f"frames {self.path}")
        colour = np.asarray(picture, np.uint8) if self._in_colour and picture.ndim == 3 else None
        grey, counts = (_grey_of(raw), None) if thermal is None else thermal.picture(raw)
        return Frame(item.stamp_ns, number, grey, item.name, colour=colour, counts=counts)

    def _place_of(self, time_s: float, due: int) -> int:
        """Return the frame of a container's time: the one that is due, or a later one of exactly that time."""
        place = bisect.bisect_left(self._times_s, time_s - SAME_S)
        is_there = place < len(self._times_s) and abs(self._times_s[place] - time_s) < SAME_S
        return max(place, due) if is_there else due
