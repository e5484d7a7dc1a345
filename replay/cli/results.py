"""`replan view`: what looks at results."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from logs.errors import ConfigError
from replay.cli.app import Begin, Ego, End, Map, Settings, answered, app, log_settings


@app.command()
def view(
    target: Annotated[Path, typer.Argument(help="A log, a recording (.rrd), or a folder of results.")],
    save: Annotated[Path | None, typer.Option(help="Write the log's recording here instead of opening it.")] = None,
    memory_limit: Annotated[str, typer.Option(help="Of the viewer.")] = "2GB",
    web: Annotated[bool, typer.Option("--web", help="Show it in a browser.")] = False,
    port: Annotated[int, typer.Option(min=1, max=65535, help="Of the page, with --web; on this machine only.")] = 9090,
    ego: Ego = None,
    road_map: Map = None,
    begin: Begin = None,
    end: End = None,
    config: Settings = None,
) -> None:
    """Open a log or recordings in the Rerun viewer.

    [bold]Examples[/bold]

      replan view results/run-001
      replan view my_log.mcap --save my_log.rrd
    """
    with answered():
        import tempfile

        from logs.readers import reader_of
        from replay.view import recordings, save_log, show

        if not target.exists():
            raise ConfigError(f"{target}: no such file or folder")
        is_log = target.suffix != ".rrd" and (target.is_file() or reader_of(target) is not None)
        settings = log_settings(config, ego, road_map, begin, end)
        if save is not None:
            if not is_log:
                raise ConfigError(f"--save writes the recording of a log; {target} holds recordings already")
            if save.suffix != ".rrd":
                raise ConfigError(f"--save {save}: a recording is called FILE.rrd")
            save_log(target, save, settings)
            typer.echo(save)
            return
        if not is_log:
            show([target] if target.is_file() else recordings(target), memory_limit, web=web, port=port)
            return
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / f"{target.stem}.rrd"
            save_log(target, recording, settings)
            show([recording], memory_limit, web=web, port=port)
