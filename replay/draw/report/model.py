"""What a report says, as plain words and numbers; `replay.draw.report.overview` makes it of the results of a run."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan

from metrics.compare import Comparison
from metrics.judge.aggregate import BOTH, SUITE
from replay.draw.report.columns import Column

NOTHING = "-"
BROKEN = "Charts that could not be drawn"


@dataclass(frozen=True)
class Cell:
    """A value in a table: as text, as the number (NaN: there is none), and whether it deserves colour."""

    text: str = NOTHING
    value: float = nan
    bad: bool = False


@dataclass(frozen=True)
class DriveRow:
    """A log and a planner, both loops.

    Attributes:
        log: Name of the log.
        planner: Name of the planner; `shown` is with its marks: oracle, trusted, batched, not deterministic.
        verdict: The worst outcome of the gates on this log; "" where none was asked.
        asked: How many of the gates were asked, of how many: "24/41".
        end: How the closed loop ended.
        cells: One per column of `Overview.columns`.
        files: Traces and recordings, relative to the result folder.
        folder: Of the log, relative likewise.
    """

    log: str
    planner: str
    shown: str
    verdict: str
    asked: str
    end: Cell
    cells: tuple[Cell, ...]
    files: tuple[str, ...]
    folder: str

    @property
    def trouble(self) -> int:
        """How many of its cells are coloured."""
        return self.end.bad + sum(cell.bad for cell in self.cells)

    @property
    def recording(self) -> str:
        """The recording of the closed loop, else of the open one; "" where there is none."""
        return next(iter(sorted(file for file in self.files if file.endswith(".rrd"))), "")

    @property
    def trace(self) -> str:
        """The trace of the closed loop, else of the open one."""
        return next(iter(sorted(file for file in self.files if file.endswith(".mcap"))), "")


@dataclass(frozen=True)
class GateRow:
    """What a gate says of one planner in one loop.

    Attributes:
        outcome: "pass", "fail" or "inconclusive".
        rule: "gap.min >= 0.5 [closed]".
        over: What must hold it: "worst" (every log), or what the logs make together.
        found: In short: of a pass the value nearest to the bound, else the reason.
        reason: The whole sentence.
        why: Why the gate is there.
        planner: "" where none was to be judged; `mode` likewise.
        group: Which logs, of a gate that is asked of each group; else "".
        log: The worst log; "" where there is none.
        value: The judged value; NaN where there is none.
        unit: Of the value.
        time_s: When it occurred; NaN where it has no time.
    """

    outcome: str
    rule: str
    over: str
    found: str
    reason: str
    why: str
    planner: str
    mode: str
    group: str
    log: str
    value: float
    unit: str
    time_s: float


@dataclass(frozen=True)
class PassShare:
    """How many logs of a group pass, with the 95 % interval of the share (`metrics.judge.aggregate`).

    Attributes:
        kind: "suite", "family", "tag" or "dataset"; `group` is its name, "" of the suite.
        mode: "open", "closed", or "both" together.
        missing: Logs that could not be evaluated; they count as not passed, as inconclusive ones do.
    """

    kind: str
    group: str
    planner: str
    mode: str
    logs: int
    passed: int
    failed: int
    inconclusive: int
    missing: int
    share: float
    low: float
    high: float

    @property
    def name(self) -> str:
        """The group in words."""
        return "all logs" if self.kind == SUITE else f"{self.kind} {self.group}"

    @property
    def text(self) -> str:
        """The share in words: "15 of 17 pass: 88%, 95% interval 66% to 97%"."""
        interval = f"{100.0 * self.low:.0f}% to {100.0 * self.high:.0f}%"
        return f"{self.passed} of {self.logs} pass: {100.0 * self.share:.0f}%, 95% interval {interval}"


@dataclass(frozen=True)
class Coverage:
    """How much was driven or planned along; `km` is NaN in open loop, where nothing is driven."""

    planner: str
    mode: str
    logs: int
    driven_s: float
    logged_s: float
    km: float

    @property
    def text(self) -> str:
        """One line."""
        word = "planned along" if self.mode == "open" else "driven"
        km = f", {self.km:.2f} km" if isfinite(self.km) else ""
        logs = f"{self.logs} {'log' if self.logs == 1 else 'logs'}"
        seconds = f"{self.driven_s:.0f} of {self.logged_s:.0f} s"
        return f"{self.planner}, {self.mode} loop: {seconds} {word} in {logs}{km}"


@dataclass(frozen=True)
class StageTime:
    """How long a stage of a plan took: quantiles over all frames of both loops, ms, and its share of the whole."""

    planner: str
    stage: str
    p50_ms: float
    p95_ms: float
    p99_ms: float
    share: float


@dataclass(frozen=True)
class Overview:
    """What a report says, in its order.

    Attributes:
        outcome: In words, as `replan evaluate` ends; `exit_code` likewise.
        shard: "2/5": which part of a run this is, that is not judged; else "".
        replan: Version that drove.
        config: First 12 hex digits of the SHA-256 of the resolved configuration.
        logs: How many were asked for.
        columns: Of `drives`.
        drives: In the order of the run.
        planners: Names, oracles and the trusted marked: columns of `compared`.
        compared: A label, and a text per planner.
        frames: How many plans the latencies are of.
        latency: By planner and stage, the whole plan last.
        gates: What is not passed first; those that were asked of no log are left out.
        not_asked: The gates that were not asked of a log, with the commonest reason, a line each.
        shares: Pass shares: suite, families, tags, datasets.
        coverage: By planner and loop.
        ensembles: How many verdicts were tried in worlds that should not matter.
        fragile: Those that did not hold, a sentence each.
        notes: What was assumed, with how many logs it concerns, the commonest first.
        failures: What could not be evaluated.
        worst: The drive to look at first.
        comparison: With a baseline, where there is one.
        broken: Charts that could not be drawn, a sentence each: known when the page with them is written.
    """

    outcome: str
    exit_code: int
    shard: str
    replan: str
    config: str
    logs: int
    columns: tuple[Column, ...]
    drives: tuple[DriveRow, ...]
    planners: tuple[str, ...]
    compared: tuple[tuple[str, tuple[str, ...]], ...]
    frames: int
    latency: tuple[StageTime, ...]
    gates: tuple[GateRow, ...]
    not_asked: tuple[str, ...]
    shares: tuple[PassShare, ...]
    coverage: tuple[Coverage, ...]
    ensembles: int
    fragile: tuple[str, ...]
    notes: tuple[str, ...]
    failures: tuple[str, ...]
    worst: DriveRow | None
    comparison: Comparison | None
    broken: tuple[str, ...] = ()

    @property
    def whole(self) -> tuple[PassShare, ...]:
        """The pass shares over all logs, one per planner, over the loops that were run."""
        mine = [share for share in self.shares if share.kind == SUITE]
        together = {share.planner for share in mine if share.mode == BOTH}
        return tuple(share for share in mine if share.mode == BOTH or share.planner not in together)

    @property
    def grouped(self) -> tuple[PassShare, ...]:
        """The pass shares of the groups that say something of their own: of two logs or more, and not of all.

        Over the loops that were run, the lowest first.
        """
        modes = {share.planner: share.mode for share in self.whole}
        mine = [share for share in self.shares if 1 < share.logs < self.logs and share.mode == modes[share.planner]]
        return tuple(sorted(mine, key=lambda share: share.share))
