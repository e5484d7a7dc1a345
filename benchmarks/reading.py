"""How fast logs are read, and of how much of an hour-long bag a part is read.

    python benchmarks/reading.py [--hour]

The same 200 frames of 50 road users as a native log (without and with Foxglove's channels, where
their schemas are installed), as a rosbag2 MCAP of Autoware's TrackedObjects, and of
PredictedObjects with two paths of 21 poses each: CPU time of the whole way from the file to the
scenario, median of some passes. With --hour: a bag of an hour (poses at 50 Hz, ten objects and a
camera of 8 kB at 10 Hz, not compressed), of which parts are read in new processes; bytes are those
that the process read from files, imports left out (Linux).
"""

from __future__ import annotations

import argparse
import json
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from replan.logs.agents import AgentKind
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.readers import LogSettings, read_log
from replan.logs.road import Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
import ros_bags as bags

FRAMES, OBJECTS, PASSES = 200, 50, 15
NATIVE_MS, CDR_MS = 30.0, 150.0
HOUR_S, CAMERA_BYTES = 3600, 8000
TRACKED, PREDICTED = (
    f"autoware_perception_msgs/msg/{name}Objects" for name in ("Tracked", "Predicted")
)
PARTS = ({}, {"end": 30.0}, {"begin": 1800.0, "end": 1830.0}, {"begin": 3570.0, "end": 3600.0})


def crowd() -> Scenario:
    """The ego on a straight road among many who drive on straight lines."""
    t = np.arange(FRAMES) / 10.0
    rng = np.random.default_rng(1)
    start, v = rng.uniform(-80.0, 80.0, (2, OBJECTS, 1)), rng.uniform(-9.0, 9.0, (2, OBJECTS, 1))
    (x, y), (vx, vy) = (start + v * t).reshape(2, -1), np.repeat(v, FRAMES, axis=2).reshape(2, -1)
    ids = tuple(f"{i:032x}" for i in range(OBJECTS))
    tracks = Tracks(
        ids,
        (AgentKind.CAR,) * OBJECTS,
        np.full(OBJECTS, 4.5),
        np.full(OBJECTS, 1.8),
        np.zeros(OBJECTS, np.bool_),
        FRAMES * np.arange(OBJECTS + 1),
        np.tile(t, OBJECTS),
        x,
        y,
        np.arctan2(vy, vx),
        vx,
        vy,
    )
    ego = Trajectory(t, 8.0 * t, 0 * t, 0 * t, 8.0 + 0 * t, 0 * t, 0 * t)
    road = Road.along(np.column_stack([ego.x, ego.y]), speed_limit=13.9)
    return Scenario("crowd", ego, tracks, road, float(t[-1]))


def objects_of(scenario: Scenario, kind: str) -> Iterator[bags.Row]:
    """The road users as messages of Autoware."""
    tracks, prefix = scenario.tracks, "initial_" if kind == PREDICTED else ""
    for k in range(FRAMES):
        ns, items = bags.START_NS + k * 100_000_000, []
        for i in range(len(tracks)):
            at = i * FRAMES + k
            x, y, yaw = (float(getattr(tracks, name)[at]) for name in ("x", "y", "yaw"))
            speed = float(np.hypot(tracks.vx[at], tracks.vy[at]))
            kinematics: dict[str, Any] = {
                f"{prefix}pose_with_covariance": {"pose": bags.pose(x, y, yaw)},
                f"{prefix}twist_with_covariance": {"twist": {"linear": {"x": speed}}},
            }
            if prefix:
                path = {"path": [bags.pose(x + k, y, yaw) for k in range(21)], "confidence": 0.5}
                kinematics["predicted_paths"] = [path, path]
            items.append(
                {
                    "object_id": {"uuid": np.frombuffer(bytes.fromhex(tracks.ids[i]), np.uint8)},
                    "classification": [{"label": 1, "probability": 0.9}],
                    "kinematics": kinematics,
                    "shape": {"dimensions": {"x": 4.5, "y": 1.8, "z": 1.5}},
                }
            )
        yield (
            "/perception/objects",
            kind,
            ns,
            bags.message(kind, header=bags.header(ns), objects=items),
        )


def cpu_ms(act: Callable[[], Any]) -> float:
    """CPU time, median of `PASSES` after one that does not count, ms."""
    act()
    found = []
    for _ in range(PASSES):
        begin = time.process_time()
        act()
        found.append(1e3 * (time.process_time() - begin))
    return float(np.median(found))


def whole_logs(folder: Path) -> None:
    """The table of the same crowd in each format."""
    scenario = crowd()
    native = folder / "native.mcap"
    write_scenario(native, scenario)
    paths = {f"native (bar {NATIVE_MS:.0f} ms)": native}
    if find_spec("foxglove_schemas_protobuf"):
        from replan.draw.foxglove import scenario_messages

        paths["native with Foxglove's channels"] = folder / "foxglove.mcap"
        write_scenario(folder / "foxglove.mcap", scenario, beside=scenario_messages(scenario))
    ego = bags.odometry(duration=0.1 * (FRAMES - 1))
    for kind, name in ((TRACKED, "tracked"), (PREDICTED, "predicted")):
        paths[f"CDR, {name} (bar {CDR_MS:.0f} ms)"] = bags.write_ros2(
            folder / name, [*ego, *objects_of(scenario, kind)], compressed=False
        )
    print(f"{FRAMES} frames of {OBJECTS} road users, CPU time of file to scenario")
    for name, path in paths.items():
        read = read_scenario if path.suffix == ".mcap" else read_log
        files = [path] if path.is_file() else list(path.glob("*.mcap"))
        held = len(read(path).tracks.t)
        assert held == FRAMES * OBJECTS, (name, held)
        took, size = (
            cpu_ms(lambda read=read, path=path: read(path)),
            sum(each.stat().st_size for each in files),
        )
        print(f"    {name:36} {took:7.1f} ms {size / 1e6:8.2f} MB", flush=True)


def stamped(raw: bytes, ns: int) -> bytes:
    """CDR of a message that begins with a header, of another time."""
    return raw[:4] + struct.pack("<iI", *divmod(ns, 1_000_000_000)) + raw[12:]


def write_hour(path: Path) -> None:
    """A bag of `HOUR_S`: the same messages with other times, but for the ego, who drives on a large
    circle.
    """
    camera = "sensor_msgs/msg/CompressedImage"
    picture = np.random.default_rng(2).integers(0, 256, CAMERA_BYTES, dtype=np.uint8)
    boxes = next(iter(objects_of(crowd(), TRACKED)))[3]
    boxes.objects[:] = boxes.objects[:10]
    same = {
        "/camera": (camera, bags.message(camera, header=bags.header(0, "camera"), data=picture)),
        "/objects": (TRACKED, boxes),
    }
    types, pose = bags.STORE, "geometry_msgs/msg/PoseStamped"
    with bags.Writer(path, version=9, storage_plugin=bags.StoragePlugin.MCAP) as writer:
        lines = {
            topic: writer.add_connection(topic, kind, typestore=types)
            for topic, (kind, _) in same.items()
        }
        raw = {
            topic: bytes(types.serialize_cdr(each, kind)) for topic, (kind, each) in same.items()
        }
        ego = writer.add_connection("/pose", pose, typestore=types)
        for k in range(HOUR_S * 50):
            ns, turn = bags.START_NS + k * 20_000_000, 0.016 * k / 200.0
            at = bags.pose(200.0 * np.sin(turn), 200.0 * (1.0 - np.cos(turn)), turn % (2.0 * np.pi))
            each = bags.message(pose, header=bags.header(ns), pose=at)
            writer.write(ego, ns, types.serialize_cdr(each, pose))
            if k % 5 == 0:
                for topic in same:
                    writer.write(lines[topic], ns, stamped(raw[topic], ns))


def measured(path: Path, settings: dict[str, float]) -> None:
    """In a process of its own: read a part, print what it took as JSON."""
    read_log_of(path, {"begin": 0.0, "end": 1e-3}, quiet=True)  # imports and kernels do not count
    files, begin, cpu = _read_bytes(), time.perf_counter(), time.process_time()
    scenario = read_log_of(path, settings)
    out = {
        "wall_s": time.perf_counter() - begin,
        "cpu_s": time.process_time() - cpu,
        "read_mb": (_read_bytes() - files) / 1e6,
        "peak_mb": peak_mb(),
        "seconds": scenario.duration,
        "samples": len(scenario.tracks.t),
    }
    print(json.dumps(out))


def read_log_of(path: Path, settings: dict[str, float], *, quiet: bool = False) -> Any:
    """The scenario; where `quiet`, errors do not count."""
    try:
        return read_log(path, LogSettings(**settings))
    except Exception:
        if quiet:
            return None
        raise


def peak_mb() -> float:
    """Most memory that this process had so far, its imports (about 260 MB) included."""
    fields = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return float(fields["VmHWM"].split()[0]) / 1024.0


def _read_bytes() -> int:
    fields = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
    return int(fields["rchar"])


def parts_of_an_hour(folder: Path) -> None:
    """The table of parts."""
    path = folder / "hour"
    write_hour(path)
    size = sum(each.stat().st_size for each in path.glob("*.mcap"))
    print(f"a bag of an hour, {size / 1e6:.0f} MB")
    for part in (PARTS[1], PARTS[2], PARTS[3], PARTS[0]):
        command = [sys.executable, __file__, "--part", str(path), json.dumps(part)]
        said = json.loads(
            subprocess.run(command, capture_output=True, text=True, check=True).stdout
        )
        print(
            f"    {part or 'all of it'!s:36}",
            ", ".join(f"{k} {v:.2f}" for k, v in said.items()),
            flush=True,
        )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--hour", action="store_true", help="the hour-long bag too (600 MB on disk)"
    )
    parser.add_argument("--part", nargs=2, metavar=("BAG", "JSON"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.part:
        measured(Path(arguments.part[0]), json.loads(arguments.part[1]))
        return
    with tempfile.TemporaryDirectory() as folder:
        whole_logs(Path(folder))
        if arguments.hour:
            parts_of_an_hour(Path(folder))


if __name__ == "__main__":
    main()
