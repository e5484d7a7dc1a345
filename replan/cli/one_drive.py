"""`replan view | plot | explain | frame`: look at one drive of a run: the named one, otherwise the
worst.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import typer

from replan.cli import options as opt
from replan.cli.app import app, say, say_json, say_sentences
from replan.cli.options import completion, log_table, option, run_config
from replan.core.errors import ConfigError, unknown_name
from replan.core.names import counted

if TYPE_CHECKING:
    from replan.draw.drawn_results import DriveResult, Results
    from replan.logs.readers import LogSettings


class ChosenDrive(NamedTuple):
    """A drive, and a remark in brackets on why it was chosen; "" if no other drive matches."""

    drive: DriveResult
    remark: str


def matching_drives(
    results: Results, log: str | None, planner: str | None, mode: opt.Loop | None
) -> list[DriveResult]:
    """The drives of a run that fit some options.

    `log`: name of a log, or a part of it (`named_logs`); None: any. `planner`: name of a planner;
    None: any. `mode`: "open" or "closed"; "both" and None: either. ConfigError if none fits.
    """
    from replan.results.load import named_logs

    table = results.drives
    wanted = {"log": log, "planner": planner, "mode": None if mode == "both" else mode}
    for column, value in wanted.items():
        if value is not None:
            if column == "log":
                allowed = named_logs(value, table["log"])
            elif value in set(table[column]):
                allowed = [value]
            else:
                raise unknown_name(
                    f"{column} (in the run)", value, list(dict.fromkeys(table[column]))
                )
            table = table[table[column].isin(allowed)]
    if table.empty:
        raise ConfigError(f"{results.path}: no drive with these options")
    return [
        results.drive(*key)
        for key in table[["log", "planner", "mode"]].itertuples(index=False, name=None)
    ]


def chosen_drive(
    results: Results, log: str | None, planner: str | None, mode: opt.Loop | None
) -> ChosenDrive:
    """The worst of the matching drives (`matching_drives`), as `worst_drive`."""
    options = {"log": log, "planner": planner, "mode": mode}
    others = ", ".join(f"--{name}" for name, value in options.items() if value is None)
    return worst_drive(results, matching_drives(results, log, planner, mode), others or "--log")


def worst_drive(results: Results, drives: Sequence[DriveResult], options: str) -> ChosenDrive:
    """The worst of some drives of a run; the remark gives the options that select another drive.

    Worst is the first in the reports (`Overview.drives`); of two loops, the one in which a gate
    failed, otherwise the closed one.
    """
    from replan.draw.report.overview import overview

    if len(drives) == 1:
        return ChosenDrive(drives[0], "")
    rows = {
        (row.log, row.planner): position for position, row in enumerate(overview(results).drives)
    }

    def rank(drive: DriveResult) -> tuple[int, bool, bool]:
        failed = bool((drive.verdicts["outcome"] == "fail").any())
        return rows[drive.log, drive.planner], not failed, drive.mode != "closed"

    return ChosenDrive(
        min(drives, key=rank), f" (the worst of {len(drives)} drives; another: {options})"
    )


@app.command()
def view(
    targets: Annotated[
        list[Path],
        typer.Argument(
            help="A log, a recording (.rrd), or a folder of results; or two drives of one log."
        ),
    ],
    log: opt.OfLog = None,
    planner: opt.OfPlanner = None,
    mode: opt.OfMode = None,
    save: Annotated[
        Path | None,
        opt.output(
            "Write the recording (FILE.rrd) of the log, or of both drives, and open nothing.",
            "--save",
        ),
    ] = None,
    screenshot: Annotated[
        Path | None,
        opt.output(
            "Write a picture (PNG) and open nothing; of a run: of the worst drive.", "--screenshot"
        ),
    ] = None,
    video: Annotated[
        Path | None,
        opt.output("Write a video: FILE.gif, or with ffmpeg FILE.mp4; --from, --to.", "--video"),
    ] = None,
    at: Annotated[float | None, opt.at_option("For --screenshot. Default: 0.")] = None,
    layout: Annotated[
        str, typer.Option(help="Layout of picture and video: overview, planner, control.")
    ] = "overview",
    tile: Annotated[
        str | None, typer.Option("--tile", help="A picture of this view only, by its title.")
    ] = None,
    size: Annotated[str, typer.Option(help="Size of picture and video, pixels.")] = "1920x1080",
    theme: Annotated[
        Literal["dark", "light"], typer.Option(help="Theme of picture and video.")
    ] = "dark",
    memory_limit: Annotated[str, typer.Option(help="Memory limit of the viewer.")] = "2GB",
    web: Annotated[bool, typer.Option("--web", help="Show it in a browser.")] = False,
    port: Annotated[
        int,
        typer.Option(min=1, max=65535, help="Port of the page, with --web; on this machine only."),
    ] = 9090,
    ego: opt.Ego = None,
    road_map: opt.Map = None,
    begin: opt.Begin = None,
    end: opt.End = None,
    repair: opt.Repair = None,
    config: opt.Settings = None,
) -> None:
    """Open a log or recordings in the Rerun viewer; or two drives of one log in one window.

    [bold]Examples[/bold]

      replan view results/run-001
      replan view my_log.mcap --save my_log.rrd
      replan view results/main results/mine --log everyday/cut_in
      replan view results/run-001 --screenshot worst.png
      replan view results/run-001 -p idm --mode closed
      replan view results/run-001 --log cut_in --screenshot cut_in.png --at 6.5 --layout planner
    """
    import tempfile
    from contextlib import ExitStack

    from replan.core.urls import Near
    from replan.draw.recording.pictures import BY_FFMPEG, BY_PILLOW, LAYOUTS
    from replan.draw.view import picture, show
    from replan.run.claim import claimed_file

    if layout not in LAYOUTS:
        raise ConfigError(f"--layout {layout}: there are {', '.join(LAYOUTS)}")
    if at is not None and screenshot is None:
        raise ConfigError(
            "--at is the time of a picture: give --screenshot FILE.png, too; for a video, --from "
            "and --to"
        )
    drawn = screenshot is not None or video is not None
    which = (log, planner, None if mode == "both" else mode)
    with ExitStack() as claims:
        for target_file, suffixes in (
            (save, (".rrd",)),
            (screenshot, (".png",)),
            (video, BY_PILLOW + BY_FFMPEG),
        ):
            if target_file is not None:
                claims.enter_context(claimed_file(target_file, suffixes))
        scratch = claims.enter_context(tempfile.TemporaryDirectory())
        span = (None, None) if video is not None else (begin, end)
        settings = run_config(config, {"log": log_table(ego, road_map, *span, repair)}).log
        copies = [Near(target) for target in targets]
        files, remark = _files(
            [copy.path for copy in copies], which, Path(scratch), settings, save, only_worst=drawn
        )
        if save is not None:
            say(save)
        if screenshot is not None:
            picture(files[-1], screenshot, at or 0.0, layout, tile, size, theme)
            say(f"{screenshot}{remark}")
        if video is not None:
            from replan.draw.recording.pictures import film

            frames = film(files[-1], video, begin, end, layout=layout, size=size, theme=theme)
            say(f"{video}{remark}: {counted(frames, 'frame')}")
        if save is None and not drawn:
            show(files, memory_limit, web=web, port=port)


# Log, planner and loop that the user named; None: any
Which = tuple[str | None, str | None, opt.Loop | None]


def _files(
    targets: list[Path],
    which: Which,
    scratch: Path,
    settings: LogSettings,
    save: Path | None,
    *,
    only_worst: bool,
) -> tuple[list[Path], str]:
    """The recordings to open, made as `save` or in `scratch`.

    With `only_worst` only the worst, and a remark that names it.
    """
    from replan.core.files import check_named
    from replan.draw.drawn_results import load
    from replan.draw.view import choose_pair, save_log, save_pair, to_open
    from replan.logs.readers import reader_of
    from replan.mine.mined_log import markers

    for target in targets:
        check_named(target)
        if not target.exists():
            raise ConfigError(f"{target}: no such file or folder")
    if len(targets) > 2:
        raise ConfigError("name one log, recording or folder, or two drives of one log")
    if any(which) and all(target.is_file() for target in targets):
        raise ConfigError("--log, --planner and --mode choose drives of a folder of results")
    if len(targets) == 2:
        pair = choose_pair(
            targets[0], targets[1], *(_recordings(target, which) for target in targets)
        )
        recording = save or scratch / "pair.rrd"
        save_pair(recording, pair)
        return [recording], ""
    (target,) = targets
    if target.suffix != ".rrd" and (target.is_file() or reader_of(target) is not None):
        recording = save or scratch / f"{target.stem}.rrd"
        save_log(target, recording, settings, markers)
        return [recording], ""
    if save is not None:
        raise ConfigError(
            f"--save writes the recording of a log or of two drives; {target} has its recordings "
            "already"
        )
    if target.is_file():
        return [target], ""
    files, judged = _recordings(target, which), (target / "summary.json").is_file()
    if not only_worst:
        return to_open(target, files, scratch, index=judged and not any(which)), ""
    if len(files) == 1:
        return files, ""
    if not judged:
        raise ConfigError(f"{target}: {len(files)} recordings; name one, for example {files[0]}")
    results = load(target)
    drives = [
        drive
        for drive in matching_drives(results, *which)
        if drive.trace_file.with_suffix(".rrd") in files
    ]
    worst = worst_drive(results, drives, "--log, --planner, --mode, or name a recording")
    return [worst.drive.trace_file.with_suffix(".rrd")], f"  {worst.drive.title}{worst.remark}"


def _recordings(target: Path, which: Which) -> list[Path]:
    """The recordings of a folder, of a run only those of the drives that fit; a file is its own."""
    from replan.draw.drawn_results import load
    from replan.draw.view import recordings

    if target.is_file():
        return [target]
    if not any(which) or not (target / "summary.json").is_file():
        if which[1] or which[2]:
            raise ConfigError(
                f"--planner and --mode choose drives of a result folder, and {target} is none"
            )
        return recordings(target, which[0])
    files = [
        drive.trace_file.with_suffix(".rrd") for drive in matching_drives(load(target), *which)
    ]
    existing = sorted(file for file in files if file.is_file())
    if not existing:
        raise ConfigError(
            f"{target}: these drives have no recording; replan evaluate without --no-recording "
            "writes them"
        )
    return existing


class Look(StrEnum):
    """Light or dark ground; auto: an SVG follows its reader's system, a PNG is light."""

    auto = "auto"
    light = "light"
    dark = "dark"


@app.command()
def plot(
    result: Annotated[Path, typer.Argument(help="A folder of results.")],
    log_name: opt.LogByPosition = None,
    log: opt.OfLog = None,
    planner: Annotated[
        list[str] | None,
        opt.planner_option(
            None, "Drives of this planner; repeatable: the log's drives of all in one picture."
        ),
    ] = None,
    mode: opt.OfMode = None,
    at: Annotated[float | None, opt.at_option("Default: the worst moment.")] = None,
    chart: Annotated[
        str,
        typer.Option(
            autocompletion=completion("chart"),
            help=(
                "What is drawn: scene, st, sl, curves, decisions, all, or module:NAME of your own."
            ),
        ),
    ] = "all",
    out: Annotated[
        Path | None, opt.out_option("FILE.png, FILE.svg, or a folder: each by itself.")
    ] = None,
    theme: Annotated[
        Look, typer.Option(help="Auto: an SVG follows its reader's system, a PNG is light.")
    ] = Look.auto,
    width: Annotated[
        int, typer.Option(min=200, max=8000, help="Width of the picture, pixels.")
    ] = 1400,
) -> None:
    """Draw a drive as SVG or PNG: scene, S-T and S-L graph, curves, decisions. Or several of one
    log together.

    [bold]Examples[/bold]

      replan plot results/run-001
      replan plot results/run-001 --log paper/crossing_pedestrian --at 6.5 --chart st -o st.svg
      replan plot results/run-001 -p dp_qp -p idm --chart curves
    """
    from replan.draw.charts.chart import FORMATS
    from replan.draw.charts.layout import charts_of, together
    from replan.draw.charts.subject import subject
    from replan.draw.drawn_results import load
    from replan.results.tables import numbered, safe_name
    from replan.run.claim import claimed_files

    run, planners = load(result), list(dict.fromkeys(planner or ()))
    chosen = chosen_drive(run, opt.only_log(log_name, log), next(iter(planners), None), mode)
    drive = chosen.drive
    drawn = subject(drive, at, [run.drive(drive.log, other, drive.mode) for other in planners[1:]])
    name = "-".join(
        [safe_name(drive.log), *map(safe_name, planners or [drive.planner]), drive.mode]
    )
    path = Path(f"{name}-{safe_name(chart)}.png") if out is None else out
    if path.suffix not in ("", *FORMATS) and not path.is_dir():
        raise ConfigError(f"{path}: a picture ends with .png or .svg, a folder has no ending")
    with claimed_files(path, FORMATS) as path_of:
        charts = charts_of(drawn, chart, width)
        if path.suffix in FORMATS and not path.is_dir():
            together(charts, drawn.title, drawn.says, width).save(
                path, theme=theme.value, width=width
            )
            say(f"{path}  ({drawn.title}, {drawn.says}){chosen.remark}")
            return
        names = numbered(f"{name}-{drawing.name}" for drawing in charts)
        files = [
            (path_of(f"{label}{ending}"), drawing)
            for label, drawing in zip(names, charts, strict=True)
            for ending in FORMATS
        ]
        for file, drawing in files:
            drawing.save(file, theme=theme.value, width=width)
            say(file)


@app.command()
def explain(
    result: Annotated[Path, typer.Argument(help="A folder of results.")],
    log_name: opt.LogByPosition = None,
    log: opt.OfLog = None,
    planner: opt.OfPlanner = None,
    mode: opt.OfMode = None,
    at: Annotated[
        float | None, opt.at_option("Default: the phases of the drive in ten lines.")
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Each change of a decision, in full.")
    ] = False,
    table: Annotated[
        Path | None, opt.output("Write what its plans used to FILE.parquet.", "--table")
    ] = None,
    as_json: opt.Json = False,
) -> None:
    """Print why a drive slows down: when, for which road user, the alternatives and their costs
    (docs/why.md). What is wrong with the input of its plans comes first.

    [bold]Examples[/bold]

      replan explain results/run-001
      replan explain results/run-001 --all
      replan explain results/run-001 paper/crossing_pedestrian --at 6.5
    """
    from replan.draw.drawn_results import load
    from replan.explain.explanation import explained, lines_of, summary
    from replan.explain.input_faults import describe_input, use_of
    from replan.results.schema import is_table
    from replan.results.tables import write_parquet
    from replan.run.claim import claimed_file

    chosen = chosen_drive(load(result), opt.only_log(log_name, log), planner, mode)
    drive = chosen.drive
    if table is not None:
        with claimed_file(table, (".parquet",), partial(is_table, name="input_use.parquet")):
            write_parquet(table, use_of(drive).table(), "input_use.parquet")
        say(table)
        return
    ended = (
        f"{chosen.drive.title}: {drive.info['end']} after {drive.info['t_end_s']:.2f} "
        f"s{chosen.remark}"
    )
    if at is None and not every and not as_json:
        lines = [*describe_input(use_of(drive)), *summary(drive)]
        say_sentences([ended, *map(drive.scenario.short_names, lines)])
        say("more: --at T for one instant, --all for every change of a decision")
        return
    explanations = explained(drive, at)
    if as_json:
        say_json(
            {"log": drive.log, "planner": drive.planner, "mode": drive.mode, "frames": explanations}
        )
        return
    say(ended)
    for explanation in explanations:
        say_sentences(["", *map(drive.scenario.short_names, lines_of(explanation))])


@app.command()
def frame(
    result: Annotated[Path, typer.Argument(help="A folder of results.")],
    at: Annotated[float, opt.at_option("The last frame up to it is planned again.")],
    log_name: opt.LogByPosition = None,
    log: opt.OfLog = None,
    planner: opt.OfPlanner = None,
    mode: opt.OfMode = None,
    other: Annotated[
        str | None,
        option(None, "Plan the frame with this planner instead.", "--with", complete="planner"),
    ] = None,
    change: Annotated[
        list[str] | None,
        option(
            None,
            'Change the input, repeatable: "delay agents 11" (docs/experiments.md).',
            "--change",
            metavar="TEXT",
        ),
    ] = None,
    dump: Annotated[
        Path | None, opt.output("Write frames, plan and QPs to FILE.msgpack.", "--dump")
    ] = None,
    debug: Annotated[
        bool, typer.Option("--debug", help="Open the debugger before the frame is planned.")
    ] = False,
) -> None:
    """Drive up to a frame again, in one process, and plan it with a report: stages, times, sizes,
    residuals.

    [bold]Examples[/bold]

      replan frame results/run-001 --at 6.5 --dump frame.msgpack
      replan frame results/run-001 --at 6.5 --with idm
      replan frame results/run-001 --at 6.5 --change "delay agents 11" --with dp_qp
    """
    from contextlib import nullcontext

    from replan.draw.drawn_results import load
    from replan.explain.input_changes import parse
    from replan.run.claim import claimed_file
    from replan.run.frame_dump import dump as write_dump, replan_frame, report_of

    results, changes = load(result), list(map(parse, change or ()))
    if planner is not None and planner not in (driven := set(results.drives["planner"])):
        raise ConfigError(
            f"no drive of '{planner}' in the run ({', '.join(sorted(driven))}); to plan with it: "
            "--with"
        )
    chosen = chosen_drive(results, opt.only_log(log_name, log), planner, mode)
    with nullcontext() if dump is None else claimed_file(dump, (".msgpack",)):
        again = replan_frame(chosen.drive, at, other, changes, debug=debug)
        say(f"{chosen.drive.title}{chosen.remark}")
        for line in report_of(again):
            say(line)
        if dump is not None:
            write_dump(dump, again.dump)
            say(
                f"\n{dump}: {dump.stat().st_size / 1e6:.1f} MB; replan.run.frame_dump.load reads it"
            )
