"""A feature set on the wire: bytes and microseconds against JSON, msgpack, protobuf and CDR.

    python -m benchmarks.wire [--features 100] [--repeat 200]

The sets are those of a simulated flight. Every format carries the same numbers, from a `FeatureSet` to bytes and back
to a `FeatureSet`: ours rounds to a small part of each number's own sigma and squeezes, the others keep doubles (CDR and
one protobuf: floats where a float will do). Encoded and decoded in turn; processor time, medians. Wants
`pip install msgpack protobuf pycdr2`, which nothing else here does; a format whose package is missing is left out.
"""

from __future__ import annotations

import argparse
import importlib
import json
import statistics
import types
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.machine import describe, interleaved_us, load, table, verdict

# isort: split
import numpy as np

from benchmarks.short_flight import leg, sets_of
from contract.camera import Camera
from contract.feature_set import COMMON_STATES, NUISANCES, DepthSource, FeatureSet, HeightDatum, SharedErrors, Status
from contract.wire.codec import decode, encode

GOAL_BYTES, GOAL_FEATURES, GOAL_US = 480, 100, 500.0
GOAL_RATIO = 0.8  # of the time that zlib-compressed JSON takes in the same run, whatever the machine
_UPPER = np.triu_indices(COMMON_STATES)

# name -> kind: text, whole, flag, number (one double), numbers (doubles), small (floats). What a set is made of.
FIELDS: dict[str, str] = {
    "vehicle": "text", "session": "whole", "frame": "whole", "capture_unix_ns": "whole", "status": "whole",
    "revision": "whole", "is_keyframe": "flag", "size_px": "wholes", "intrinsics": "small", "position": "numbers",
    "is_ellipsoid": "flag", "undulation_m": "number", "rotation": "numbers", "common_cov": "small", "draws": "wholes",
    "shared": "small", "times": "small",
    "source": "whole", "plane": "small", "u_px": "small", "v_px": "small", "inverse_depth": "small", "sigma": "small",
}  # fmt: skip


def to_plain(s: FeatureSet) -> dict[str, Any]:
    """A set as FIELDS of plain Python numbers."""
    c, shared = s.camera, s.shared
    return {
        "vehicle": s.vehicle,
        "session": s.session,
        "frame": s.frame,
        "capture_unix_ns": s.capture_unix_ns,
        "status": s.status.code,
        "revision": s.revision,
        "is_keyframe": s.is_keyframe,
        "size_px": [c.width_px, c.height_px],
        "intrinsics": [c.fx_px, c.fy_px, c.cx_px, c.cy_px, *c.distortion],
        "position": [s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m],
        "is_ellipsoid": s.height_datum is HeightDatum.ELLIPSOID,
        "undulation_m": s.undulation_m,
        "rotation": s.R_enu_cam.ravel().tolist(),
        "common_cov": s.common_cov[_UPPER].tolist(),
        "draws": np.flatnonzero(shared.by_nuisance.any(axis=0)).tolist(),
        "shared": shared.by_nuisance[:, shared.by_nuisance.any(axis=0)].ravel().tolist(),
        "times": [shared.position_time_s, shared.attitude_time_s, *shared.alignment_sigma.tolist(), *shared.span_s],
        "source": list(DepthSource).index(s.depth_source),
        "plane": [*s.plane_per_m.tolist(), s.plane_sigma_relative, s.roughness],
        "u_px": s.uv_px[:, 0].tolist(),
        "v_px": s.uv_px[:, 1].tolist(),
        "inverse_depth": s.inverse_depth_per_m.tolist(),
        "sigma": s.sigma_inverse_depth_per_m.tolist(),
    }


def from_plain(d: Mapping[str, Any]) -> FeatureSet:
    """The set of `to_plain`."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = d["intrinsics"]
    covariance = np.zeros((COMMON_STATES, COMMON_STATES))
    covariance[_UPPER] = d["common_cov"]
    by_nuisance = np.zeros((COMMON_STATES, NUISANCES))
    by_nuisance[:, d["draws"]] = np.reshape(d["shared"], (COMMON_STATES, -1))
    (width, height), (lat, lon, camera_height) = d["size_px"], d["position"]
    plane = list(d["plane"])
    return FeatureSet(
        d["vehicle"],
        d["session"],
        d["frame"],
        d["capture_unix_ns"],
        list(Status)[d["status"]],
        Camera(width, height, fx, fy, cx, cy, (k1, k2, p1, p2, k3)),
        d["revision"],
        d["is_keyframe"],
        lat,
        lon,
        camera_height,
        HeightDatum.ELLIPSOID if d["is_ellipsoid"] else HeightDatum.AMSL,
        d["undulation_m"],
        np.array(d["rotation"]).reshape(3, 3),
        covariance + np.triu(covariance, 1).T,
        SharedErrors(by_nuisance, d["times"][0], d["times"][1], np.array(d["times"][2:6]), tuple(d["times"][6:])),
        list(DepthSource)[d["source"]],
        np.array(plane[:3]),
        plane[3],
        plane[4],
        np.stack([d["u_px"], d["v_px"]], axis=-1),
        np.array(d["inverse_depth"]),
        np.array(d["sigma"]),
    )


@dataclass(frozen=True)
class Format:
    """A way to write sets."""

    encode: Callable[[FeatureSet], bytes]
    decode: Callable[[bytes], FeatureSet]


def _protobuf(floats: bool) -> Format:
    """A message built at run time; `floats` writes those of FIELDS called small as floats."""
    descriptor_pb2 = importlib.import_module("google.protobuf.descriptor_pb2")
    descriptor_pool = importlib.import_module("google.protobuf.descriptor_pool")
    message_factory = importlib.import_module("google.protobuf.message_factory")
    kinds = descriptor_pb2.FieldDescriptorProto
    small = kinds.TYPE_FLOAT if floats else kinds.TYPE_DOUBLE
    types = {
        "text": kinds.TYPE_STRING, "whole": kinds.TYPE_UINT64, "wholes": kinds.TYPE_UINT64, "flag": kinds.TYPE_BOOL,
        "number": kinds.TYPE_DOUBLE, "numbers": kinds.TYPE_DOUBLE, "small": small,
    }  # fmt: skip
    name = f"set_{'float' if floats else 'double'}"
    file = descriptor_pb2.FileDescriptorProto(name=f"{name}.proto", package=name, syntax="proto3")
    message = file.message_type.add(name="Set")
    for number, (field, kind) in enumerate(FIELDS.items(), 1):
        many = kind in ("numbers", "small", "wholes")
        label = kinds.LABEL_REPEATED if many else kinds.LABEL_OPTIONAL
        message.field.add(name=field, number=number, type=types[kind], label=label)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    cls = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{name}.Set"))

    def read(payload: bytes) -> FeatureSet:
        got = cls.FromString(payload)
        return from_plain({field: getattr(got, field) for field in FIELDS})

    return Format(lambda s: bytes(cls(**to_plain(s)).SerializeToString()), read)


def _cdr() -> Format:
    """A structure built at run time, floats where a float will do."""
    pycdr2, cdr = importlib.import_module("pycdr2"), importlib.import_module("pycdr2.types")
    kinds: dict[str, Any] = {
        "text": str, "whole": cdr.uint64, "wholes": cdr.sequence[cdr.uint64], "flag": bool, "number": cdr.float64,
        "numbers": cdr.sequence[cdr.float64], "small": cdr.sequence[cdr.float32],
    }  # fmt: skip
    hints = {field: kinds[kind] for field, kind in FIELDS.items()}
    body = {"__annotations__": hints, "__module__": __name__}
    # Not a class statement: this package cannot resolve the annotations that this file postpones.
    cls: Any = dataclass(
        types.new_class("CdrSet", (pycdr2.IdlStruct,), {"typename": "Set"}, lambda ns: ns.update(body))
    )
    return Format(lambda s: bytes(cls(**to_plain(s)).serialize()), lambda b: from_plain(vars(cls.deserialize(b))))


def _json() -> Format:
    return Format(
        lambda s: json.dumps(to_plain(s), separators=(",", ":")).encode(), lambda b: from_plain(json.loads(b))
    )


def _json_zlib() -> Format:
    plain = _json()
    return Format(lambda s: zlib.compress(plain.encode(s)), lambda b: plain.decode(zlib.decompress(b)))


def _msgpack() -> Format:
    msgpack = importlib.import_module("msgpack")
    return Format(lambda s: bytes(msgpack.packb(to_plain(s))), lambda b: from_plain(msgpack.unpackb(b)))


def formats() -> tuple[dict[str, Format], list[str]]:
    """All that can be had, ours first; and those whose package is not installed."""
    made, missing = {"ours": Format(encode, decode)}, []
    for name, make in {
        "JSON": _json,
        "JSON, zlib": _json_zlib,
        "msgpack": _msgpack,
        "protobuf, doubles": lambda: _protobuf(False),
        "protobuf, floats": lambda: _protobuf(True),
        "CDR, floats": _cdr,
    }.items():
        try:
            made[name] = make()
        except ModuleNotFoundError as error:
            missing.append(f"{name} (no module {error.name})")
    return made, missing


def report(sets: Sequence[FeatureSet], repeat: int) -> str:
    """The table over some sets, and whether ours is small and quick enough."""
    all_formats, missing = formats()
    sizes = {name: [len(f.encode(s)) for s in sets] for name, f in all_formats.items()}
    middle = sets[len(sets) // 2]
    payloads = {name: f.encode(middle) for name, f in all_formats.items()}
    write = interleaved_us({n: lambda f=f: f.encode(middle) for n, f in all_formats.items()}, repeat)  # type: ignore[misc]
    read = interleaved_us({n: lambda f=f, n=n: f.decode(payloads[n]) for n, f in all_formats.items()}, repeat)  # type: ignore[misc]
    ours = statistics.median(sizes["ours"])
    rows = [
        [
            name,
            f"{statistics.median(size):.0f}",
            f"{max(size)}",
            f"{statistics.median(size) / ours:.1f}",
            f"{write[name]:.0f}",
            f"{read[name]:.0f}",
        ]
        for name, size in sizes.items()
    ]
    slowest = max(write["ours"], read["ours"])
    other = "JSON, zlib"
    ratio = write["ours"] / write[other], read["ours"] / read[other]
    features = max(map(len, sets))
    lines = [
        f"{len(sets)} sets of {features} features",
        "",
        table(["format", "bytes, median", "largest", "of ours", "encode, us", "decode, us"], rows),
        "",
        *([f"left out: {', '.join(missing)}", ""] if missing else []),
        f"{ours:.0f} bytes (median) for {features} features (goal {GOAL_BYTES} for {GOAL_FEATURES}): "
        f"{verdict(ours <= GOAL_BYTES and features >= GOAL_FEATURES)}",
        f"{slowest:.0f} us at most each way (goal {GOAL_US:.0f}): {verdict(slowest <= GOAL_US)}",
        f"{ratio[0]:.2f} to write and {ratio[1]:.2f} to read of the time of {other} (goal {GOAL_RATIO} each): "
        f"{verdict(max(ratio) <= GOAL_RATIO)}",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--features", type=int, default=100)
    parser.add_argument("--repeat", type=int, default=200)
    args = parser.parse_args()
    print(f"{describe()}; {load()}\n")
    print(report(sets_of(leg(), args.features), args.repeat))


if __name__ == "__main__":
    main()
