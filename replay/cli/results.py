"""`replan view`: show logs and results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from logs.errors import ConfigError
from logs.names import counted
from replay.cli.app import Begin, Ego, End, Map, Repair, Settings, app, handle_errors, log_table, run_config, say

if TYPE_CHECKING:
    from logs.readers import LogSettings


@app.command()
def view(
    targets: Annotated[
        list[Path], typer.Argument(help="A log, a recording (.rrd), or a folder of results; or two drives of one log.")
    ],
    log: Annotated[
        str | None, typer.Option("--log", metavar="NAME", help="Of a folder, the recordings of this log: both loops.")
    ] = None,
    save: Annotated[
        Path | None, typer.Option(help="Write the recording of the log, or of both drives, and open nothing.")
    ] = None,
    screenshot: Annotated[
        Path | None,
        typer.Option("--screenshot", help="Write a picture (PNG) and open nothing; of a run: of the worst drive."),
    ] = None,
    video: Annotated[
        Path | None, typer.Option("--video", help="Write a video: FILE.gif, or with ffmpeg FILE.mp4; --from, --to.")
    ] = None,
    at: Annotated[float, typer.Option(help="Time of the picture, s.")] = 0.0,
    layout: Annotated[str, typer.Option(help="Layout of picture and video: overview, planner, control.")] = "overview",
    tile: Annotated[str | None, typer.Option("--tile", help="A picture of this view only, by its title.")] = None,
    size: Annotated[str, typer.Option(help="Size of picture and video, pixels.")] = "1920x1080",
    theme: Annotated[Literal["dark", "light"], typer.Option(help="Theme of picture and video.")] = "dark",
    memory_limit: Annotated[str, typer.Option(help="Memory limit of the viewer.")] = "2GB",
    web: Annotated[bool, typer.Option("--web", help="Show it in a browser.")] = False,
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Port of the page, with --web; on this machine only.")
    ] = 9090,
    ego: Ego = None,
    road_map: Map = None,
    begin: Begin = None,
    end: End = None,
    repair: Repair = None,
    config: Settings = None,
) -> None:
    """Open a log or recordings in the Rerun viewer; or two drives of one log in one window.

    [bold]Examples[/bold]

      replan view results/run-001
      replan view my_log.mcap --save my_log.rrd
      replan view results/main results/mine --log everyday/cut_in
      replan view results/run-001 --screenshot worst.png
      replan view results/run-001 --log cut_in --screenshot cut_in.png --at 6.5 --layout planner
    """
    with handle_errors():
        import tempfile

        from logs.files import Near
        from replay.draw.recording.pictures import LAYOUTS
        from replay.draw.view import picture, show

        if layout not in LAYOUTS:
            raise ConfigError(f"--layout {layout}: there are {', '.join(LAYOUTS)}")
        drawn = screenshot is not None or video is not None
        with tempfile.TemporaryDirectory() as kept:
            span = (None, None) if video is not None else (begin, end)
            settings = run_config(config, {"log": log_table(ego, road_map, *span, repair)}).log
            copies = [Near(target) for target in targets]
            files, remark = _files([copy.path for copy in copies], log, Path(kept), settings, save, one=drawn)
            if save is not None:
                say(save)
            if screenshot is not None:
                picture(files[-1], screenshot, at, layout, tile, size, theme)
                say(f"{screenshot}{remark}")
            if video is not None:
                from replay.draw.view import filmed

                say(f"{video}{remark}: {counted(filmed(files[-1], video, begin, end, layout, size, theme), 'frame')}")
            if save is None and not drawn:
                show(files, memory_limit, web=web, port=port)


def _files(
    targets: list[Path], log: str | None, kept: Path, settings: LogSettings, save: Path | None, *, one: bool
) -> tuple[list[Path], str]:
    """The recordings to open, made as `save`, else in `kept`; and with `one`, which takes the worst, which it is."""
    from logs.files import check_named
    from logs.readers import reader_of
    from replay.draw.view import pair, recordings, save_log, to_open, write_pair

    for target in targets:
        check_named(target)
        if not target.exists():
            raise ConfigError(f"{target}: no such file or folder")
    if len(targets) > 2:
        raise ConfigError("name one log, recording or folder, or two drives of one log")
    if len(targets) == 2:
        both, recording = pair(targets[0], targets[1], log), _place(save) or kept / "pair.rrd"
        write_pair(recording, both)
        return [recording], ""
    (target,) = targets
    if target.suffix != ".rrd" and (target.is_file() or reader_of(target) is not None):
        recording = _place(save) or kept / f"{target.stem}.rrd"
        save_log(target, recording, settings)
        return [recording], ""
    if save is not None:
        raise ConfigError(f"--save writes the recording of a log or of two drives; {target} has its recordings already")
    if target.is_file():
        return [target], ""
    if not one:
        return to_open(target, log, kept), ""
    found = recordings(target, log)
    if len(found) > 1 and (target / "summary.json").is_file():
        return _worst_of(target, found)
    if len(found) > 1:
        raise ConfigError(f"{target}: {len(found)} recordings; name one, for example {found[0]}")
    return found, ""


def _worst_of(target: Path, found: list[Path]) -> tuple[list[Path], str]:
    """Of some recordings of a run, that of the worst drive, and which it is."""
    from replay.cli.chosen import worst_drive
    from replay.results.load import load

    results = load(target)
    drives = [results.drive(*row) for row in results.drives[["log", "planner", "mode"]].itertuples(index=False)]
    there = [drive for drive in drives if drive.trace_file.with_suffix(".rrd") in found]
    worst = worst_drive(results, there, "--log, or name a recording")
    return [worst.drive.trace_file.with_suffix(".rrd")], f"  {worst.title}{worst.remark}"


def _place(save: Path | None) -> Path | None:
    """Where a recording is saved, its folder made; ConfigError where it is called otherwise."""
    from logs.errors import writing

    if save is not None and save.suffix != ".rrd":
        raise ConfigError(f"--save {save}: a recording is called FILE.rrd")
    if save is not None:
        with writing(save):
            save.parent.mkdir(parents=True, exist_ok=True)
    return save
