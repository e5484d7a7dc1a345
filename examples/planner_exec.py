"""A planner as a program of its own, without replan: it goes straight on and brakes for who stands
ahead.

    replan evaluate LOGS --planner "exec:python examples/planner_exec.py"       replan starts it,
        once per drive
    python examples/planner_exec.py 7000                                        or it runs already,
        as a node:
    replan evaluate LOGS --planner tcp://127.0.0.1:7000

The messages are those of docs/bring_planner.md: 4 bytes of length, then MessagePack, for which any
package will do.
"""

from __future__ import annotations

import math
import os
import socket
import struct
import sys
from typing import Any, BinaryIO

import msgspec

STEP_S, STEPS = 0.1, 51
BESIDE_M, BEFORE_M, GENTLE_MPS2 = 2.0, 8.0, 0.5


def column(binary: bytes) -> list[float]:
    """The numbers of a column: little-endian float64."""
    return list(struct.unpack(f"<{len(binary) // 8}d", binary))


def plan(frame: dict[str, Any]) -> dict[str, Any]:
    """A plan message for a frame message."""
    ego, agents = frame["ego"], frame["agents"]
    forward = math.cos(ego["yaw"]), math.sin(ego["yaw"])
    brake = 0.0
    for x, y in zip(column(agents["x"]), column(agents["y"]), strict=True):
        dx, dy = x - ego["x"], y - ego["y"]
        ahead, beside = dx * forward[0] + dy * forward[1], dy * forward[0] - dx * forward[1]
        if ahead > 0.0 and abs(beside) < BESIDE_M:
            brake = max(brake, ego["v"] ** 2 / (2.0 * max(ahead - BEFORE_M, 0.1)))
    brake = min(brake, 8.0) if brake > GENTLE_MPS2 else 0.0
    rows: dict[str, list[float]] = {name: [] for name in ("t", "x", "y", "yaw", "v", "a", "kappa")}
    for i in range(STEPS):
        t = i * STEP_S
        moving = min(t, ego["v"] / brake) if brake > 0.0 else t
        s, v = ego["v"] * moving - 0.5 * brake * moving**2, ego["v"] - brake * moving
        state = (
            frame["t"] + t,
            ego["x"] + s * forward[0],
            ego["y"] + s * forward[1],
            ego["yaw"],
            v,
        )
        for name, value in zip(rows, (*state, -brake if moving == t else 0.0, 0.0), strict=True):
            rows[name].append(value)
    return {"type": "plan", "trajectory": rows}


def serve(inward: BinaryIO, outward: BinaryIO) -> None:
    """One drive: answer messages until the other side closes."""
    while len(header := inward.read(4)) == 4:
        message = msgspec.msgpack.decode(inward.read(struct.unpack("<I", header)[0]))
        if message["type"] == "hello" and message["schema"] != 1:
            answer = {
                "type": "failed",
                "message": f"version {message['schema']} of the messages is not known",
            }
        # message["context"]: road, goal, vehicle, origin; message["config"]: settings
        elif message["type"] == "hello":
            answer = {"type": "ready", "schema": 1}
        else:
            answer = plan(message)
        payload = msgspec.msgpack.encode(answer)
        outward.write(struct.pack("<I", len(payload)) + payload)
        outward.flush()


def main() -> None:
    """Over stdin and stdout; with a port, one drive after another over TCP."""
    if len(sys.argv) == 1:
        outward = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)  # what is printed must not come between the messages
        serve(sys.stdin.buffer, outward)
        return
    with socket.create_server(("127.0.0.1", int(sys.argv[1]))) as server:
        sys.stderr.write(f"port {server.getsockname()[1]}\n")
        sys.stderr.flush()
        while True:
            link, _ = server.accept()
            link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with link, link.makefile("rb") as inward, link.makefile("wb") as outward:
                serve(inward, outward)


if __name__ == "__main__":
    main()
