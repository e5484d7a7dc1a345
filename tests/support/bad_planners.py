"""A zoo of planners that must not harm anything but their own drive.

Run as `bad_planners:NAME`, each kept apart.
"""

import gc
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Decision, DecisionKind, Plan, PlanStatus
from replan.planners.constant_speed import ConstantSpeed, arc

AT_S = 0.5
"""When they turn bad."""


class Raises(ConstantSpeed):
    def bad(self, frame: Frame) -> object:
        raise ValueError("no way ahead\x1b[31m")

    def plan(self, frame: Frame) -> Plan:
        return super().plan(frame) if frame.t < AT_S - 1e-9 else self.bad(frame)  # type: ignore[return-value]


class ReturnsNone(Raises):
    def bad(self, frame: Frame) -> object:
        return None


class NotFinite(Raises):
    def bad(self, frame: Frame) -> object:
        return Plan(arc(replace(frame.ego, x=float("nan")), frame.t + np.arange(3.0)))


class Past(Raises):
    def bad(self, frame: Frame) -> object:
        return Plan(arc(frame.ego, frame.t - 1.0 + np.arange(5.0)))


class Far(Raises):
    def bad(self, frame: Frame) -> object:
        return Plan(arc(replace(frame.ego, x=1e6), frame.t + np.arange(5.0)))


class OneState(Raises):
    def bad(self, frame: Frame) -> object:
        return Plan(arc(frame.ego, np.array([frame.t])))


class Sleeps(Raises):
    def bad(self, frame: Frame) -> object:
        print("zzz")
        time.sleep(1e6)
        return None


class Loops(Raises):
    def bad(self, frame: Frame) -> object:
        for name in (signal.SIGTERM, signal.SIGINT):
            signal.signal(name, signal.SIG_IGN)
        while True:
            pass


class Allocates(Raises):
    def bad(self, frame: Frame) -> object:
        kept = []
        while True:
            kept.append(np.empty(10_000_000))


class Prints(Raises):
    """Harmless, but for a protocol on stdout."""

    def bad(self, frame: Frame) -> object:
        print("x" * 200_000, flush=True)
        os.write(1, b"\xff\xff\xff\x7f" * 50_000)
        os.write(2, b"\x1b[2J" * 50_000)
        return ConstantSpeed.plan(self, frame)


class SysExits(Raises):
    def bad(self, frame: Frame) -> object:
        sys.exit(3)


class Exits(Raises):
    def bad(self, frame: Frame) -> object:
        print("going\x1b[31m home", file=sys.stderr)
        os._exit(7)


class ExitsWell(Raises):
    def bad(self, frame: Frame) -> object:
        os._exit(0)


class Segfaults(Raises):
    def bad(self, frame: Frame) -> object:
        os.kill(os.getpid(), signal.SIGSEGV)
        return None


class Closes(Raises):
    """Closes every descriptor, the messages' own among them."""

    def bad(self, frame: Frame) -> object:
        os.closerange(0, 256)
        time.sleep(1e6)
        return None


class Babbles(Raises):
    """Writes into every descriptor, the messages' own among them."""

    def bad(self, frame: Frame) -> object:
        for fd in range(3, 64):
            try:
                os.write(fd, b"\x05\x00\x00\x00hello")
            except OSError:
                continue
        return ConstantSpeed.plan(self, frame)


class Writes(Raises):
    """Into the arrays that it was given."""

    def bad(self, frame: Frame) -> object:
        frame.predictions.x.flags.writeable = True
        return None


class Daemon(Raises):
    """Leaves a process behind, whose id it prints, and exits."""

    def bad(self, frame: Frame) -> object:
        if os.fork() == 0:
            time.sleep(1e6)
        time.sleep(1e6)
        return None


class Detaches(Raises):
    """Leaves processes behind in sessions of their own, one of them twice forked, which ignore
    SIGTERM.
    """

    def bad(self, frame: Frame) -> object:
        ignore = "trap '' TERM INT HUP; echo $$ >>detached; exec sleep 98765"
        subprocess.Popen(["sh", "-c", ignore], start_new_session=True)
        subprocess.run(["setsid", "-f", "setsid", "-f", "sh", "-c", ignore], check=True)
        while not Path("detached").exists() or len(Path("detached").read_text().split()) < 2:
            time.sleep(0.01)
        return ConstantSpeed.plan(self, frame)

    def plan(self, frame: Frame) -> Plan:
        return (
            super().plan(frame) if abs(frame.t - AT_S) < 1e-9 else ConstantSpeed.plan(self, frame)
        )


class DetachesAndExits(Detaches):
    def bad(self, frame: Frame) -> object:
        super().bad(frame)
        os._exit(7)


class Long(Raises):
    """A plan of 300,000 states."""

    def bad(self, frame: Frame) -> object:
        return Plan(arc(frame.ego, frame.t + np.linspace(0.0, 8.0, 300_000)))


class Verbose(Raises):
    """A fallback with a reason of 50 MB."""

    def bad(self, frame: Frame) -> object:
        return replace(
            ConstantSpeed.plan(self, frame), status=PlanStatus.PREVIOUS, reason="x" * 50_000_000
        )


class Shows(Raises):
    """Decisions of 20 MB about one frame."""

    def bad(self, frame: Frame) -> object:
        decision = Decision("car", DecisionKind.FOLLOW, "speed", "x" * 20_000_000)
        return replace(ConstantSpeed.plan(self, frame), internals=(decision,))


class Stages(Raises):
    def bad(self, frame: Frame) -> object:
        for k in range(1000):
            self.lap(f"stage {k}")
        return ConstantSpeed.plan(self, frame)


class RaisesMuch(Raises):
    def bad(self, frame: Frame) -> object:
        raise ValueError("x" * 50_000_000)


class Hangs(Raises):
    """Says by a file who it is, and hangs; it has a process of its own beside."""

    def bad(self, frame: Frame) -> object:
        beside = os.fork()
        if beside:
            Path("hangs.partial").write_text(f"{os.getpid()} {beside}", encoding="utf-8")
            Path("hangs.partial").rename("hangs")
        while True:
            pass


class Threads(ConstantSpeed):
    """Prints and works beside its planning, for ever."""

    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context)
        threading.Thread(target=self._beside).start()

    def _beside(self) -> None:
        while True:
            print("." * 1000)
            time.sleep(0.001)


class Random(ConstantSpeed):
    def plan(self, frame: Frame) -> Plan:
        plan = super().plan(frame)
        return replace(
            plan,
            trajectory=arc(
                replace(frame.ego, kappa=float(os.urandom(1)[0]) * 1e-5), plan.trajectory.t
            ),
        )


class Unbuilt(ConstantSpeed):
    def __init__(self, context: PlannerContext, *, weight: float = 1.0) -> None:
        raise KeyError("weights.bin")


class Peeps(ConstantSpeed):
    """Looks for the log wherever Python has a way, and raises with what it has found."""

    def plan(self, frame: Frame) -> Plan:
        found = [*_objects(), *_frames(), *_environment(), *_files()]
        if frame.t > 0.15:
            raise ValueError(
                f"found {sorted(set(found), key=lambda word: (word.startswith('file'), word))}"
            )
        return super().plan(frame)


NOT_MINE = (
    "Scenario",
    "Tracks",
    "World",
    "Perception",
    "Planning",
    "Trace",
    "LogSource",
    "RunConfig",
)


def _objects() -> list[str]:
    names = {type(each).__name__ for each in gc.get_objects()}
    values = {
        type(value).__name__
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] in ("logs", "replay", "metrics", "__main__")
        for value in vars(module).values()
    }
    return [f"object {name}" for name in (names | values) & set(NOT_MINE)]


def _frames() -> list[str]:
    found, now = [], sys._getframe()
    while now is not None:
        found += [
            f"frame {type(each).__name__}"
            for each in now.f_locals.values()
            if type(each).__name__ in NOT_MINE
        ]
        now = now.f_back  # type: ignore[assignment]
    return found


def _environment() -> list[str]:
    words = [
        *sys.argv,
        *sys.orig_argv,
        *os.environ.values(),
        Path("/proc/self/cmdline").read_text(),
    ]
    return ["word " + word for word in words if "SECRET" in word or ".mcap" in word] + [
        f"variable {name}" for name in os.environ if name.startswith("SECRET")
    ]


def _files() -> list[str]:
    found = []
    for fd in range(64):
        try:
            where = str(Path(f"/proc/self/fd/{fd}").readlink())
        except OSError:
            continue
        if not where.startswith(("pipe:", "/dev/null")):
            found.append(f"file {where}")
    return found
