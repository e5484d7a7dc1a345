"""`replan score`: the scores of nuPlan and NAVSIM for drives, plans and trajectories."""

from __future__ import annotations

from contextlib import ExitStack
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from replan.cli import options as opt
from replan.cli.app import app, progress_lines, say, say_json
from replan.core.errors import ConfigError

if TYPE_CHECKING:
    from replan.draw.drawn_results import Results
    from replan.logs.scenario import Scenario
    from replan.score.submitted_plans import SubmittedPlan

MOST_ROWS = 40  # More rows are not printed
Names = Literal["nuplan-cls", "navsim-v1", "navsim-v2", "navsim-v2-old-filter"]


@app.command()
def score(
    targets: Annotated[
        list[Path], typer.Argument(help="A folder of results, or logs and folders of logs.")
    ],
    name: Annotated[Names, typer.Option("--as", help="The score.")],
    trajectories: Annotated[
        Path | None,
        typer.Option(
            help="Score these (FILE.csv, FILE.parquet): log, t_s, x, y, yaw every 0.5 s for 4 s."
        ),
    ] = None,
    relative: Annotated[
        bool,
        typer.Option(
            "--relative", help="Their poses are relative to the ego at the begin of the window."
        ),
    ] = False,
    out: Annotated[
        Path | None, opt.out_option("Write the table to FILE.csv, FILE.parquet or FILE.json.")
    ] = None,
    quiet: opt.Quiet = False,
    as_json: opt.Json = False,
) -> None:
    """Score drives and plans as nuPlan and NAVSIM do: a row for each scene, the means, and what
    cannot be exact.

    nuplan-cls scores the closed loop of a run; the others its plans of the open loop every 0.5 s,
    or the trajectories of a file in windows of 4 s. Which number compares with what:
    docs/peers.md.

    [bold]Examples[/bold]

      replan score results/run-001 --as nuplan-cls
      replan score results/run-001 --as navsim-v2 -o scores.csv
      replan score my_logs/ --trajectories agent.parquet --as navsim-v2
    """
    with ExitStack() as writes:
        from replan.run.claim import rows_file
        from replan.score.navsim_table import navsim_table
        from replan.score.nuplan_table import NUPLAN_CLS, nuplan_table

        write = writes.enter_context(rows_file(out)) if out is not None else None
        if name == NUPLAN_CLS:
            if trajectories is not None:
                raise ConfigError(
                    "--trajectories: nuplan-cls scores drives; take --as navsim-v1 or navsim-v2"
                )
            table = nuplan_table(_run(targets))
        else:
            plans, logs = _plans(targets, trajectories, relative=relative)
            print_line = progress_lines(quiet=quiet)
            scored = count(1)

            def on_plan() -> None:
                number = next(scored)
                if number % 200 == 0:
                    print_line(f"scored {number} of {len(plans)} plans")

            table = navsim_table(name, plans, logs, on_plan)
        if write is not None:
            write(table.rows)
        if as_json:
            say_json({"as": name, "rows": table.rows, "inexact": table.inexact})
        elif not quiet:
            shown = table.rows
            if len(shown) > MOST_ROWS:
                say(f"{len(table.scenes)} rows; --out writes them. The means:")
                shown = shown.tail(len(table.summary))
            say(
                shown.to_string(
                    index=False,
                    max_colwidth=60,
                    float_format=lambda value: f"{value:.4f}",
                    na_rep="-",
                )
            )
            say("Not exact:")
            say("\n".join(f"  {note}" for note in table.inexact))
        if out is not None and not as_json:
            say(out)


def _run(targets: list[Path]) -> Results:
    """The run to be scored; ConfigError if it is none."""
    from replan.draw.drawn_results import load

    if len(targets) != 1 or not (targets[0] / "summary.json").is_file():
        raise ConfigError(
            f"{targets[0]}: nuplan-cls scores the drives of a run: name a folder of results"
        )
    return load(targets[0])


def _plans(
    targets: list[Path], trajectories: Path | None, *, relative: bool
) -> tuple[list[SubmittedPlan], dict[str, Scenario]]:
    """The plans to be scored, and the logs by name; ConfigError if the targets have none."""
    from replan.draw.drawn_results import load
    from replan.run.sources import select
    from replan.score.submitted_plans import plans_of_table, plans_of_trace

    plans: list[SubmittedPlan] = []
    logs: dict[str, Scenario] = {}
    if len(targets) == 1 and (targets[0] / "summary.json").is_file():
        results = load(targets[0])
        drives = results.drives[results.drives["mode"] == "open"]
        if drives.empty:
            raise ConfigError(
                f"{targets[0]}: the run has no open loop; evaluate with --mode open or both"
            )
        for log, planner in drives[["log", "planner"]].itertuples(index=False):
            if trajectories is None or log not in logs:
                drive = results.drive(log, planner, "open")
                logs.setdefault(log, drive.scenario)
                plans += plans_of_trace(drive.trace, logs[log])
    elif trajectories is None:
        raise ConfigError(
            f"{targets[0]}: is no folder of results; score logs with --trajectories FILE"
        )
    else:
        for source in select(targets).sources:
            scenario = source.read()
            logs[scenario.name] = scenario
    return (
        plans if trajectories is None else plans_of_table(trajectories, logs, relative=relative)
    ), logs
