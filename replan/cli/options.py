"""Options of several commands: shell completion, and the configuration of a run from options."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from replan.cli.app import say, say_error, say_json
from replan.core.errors import ConfigError, unknown_name
from replan.core.urls import on_this_machine
from replan.replay.parts import PARTS, Part, loaded

if TYPE_CHECKING:
    from replan.config import RunConfig
    from replan.logs.scenario import Scenario

# names for shell completion -----------------------------------------------------------------------

OTHER_NAMES: Mapping[str, Callable[[], Iterable[str]]] = {
    "car": lambda: loaded("replan.logs.vehicle:vehicle_names")(),
    "chart": lambda: (*loaded("replan.draw.charts.layout:CHARTS"), "all"),
    "suite": lambda: loaded("replan.logs.catalogue:SUITES"),
    "kind": lambda: loaded("replan.cli.listing:KINDS"),
    "listed": lambda: chain.from_iterable(map(names, (*PARTS, "car", "chart", "suite", "kind"))),
}
"""The names that are of no kind of part.

Each table is imported when it is asked for, as this takes long.
"""


def names(option: str) -> tuple[str, ...]:
    """The names that an option takes, in the order of their tables."""
    return tuple(PARTS[option].builtin if option in PARTS else OTHER_NAMES[option]())


def completion(option: str) -> Callable[[str], list[str]]:
    """The function for `typer.Option(autocompletion=...)`."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names(option) if name.startswith(incomplete)]

    return complete


def complete_setting(incomplete: str) -> list[str]:
    """The keys that `--set` takes, each with "="; tables of planners, controllers ...

    with a name and ".".
    """
    from replan.config import RunConfig
    from replan.core.settings import dotted_keys

    tables = {kind.table: kind for kind in PARTS.values()}
    keys: list[str] = []
    table, _, part_of_key = incomplete.partition(".")
    for name in tables[table].builtin if table in tables else ():
        if part_of_key.startswith(f"{name}."):  # this one is imported, with its settings
            from replan.cli.listing import settings_of

            keys += [f"{setting.key}=" for setting in settings_of(Part(tables[table], name))]
    for key in dotted_keys(RunConfig):
        keys += [f"{key}.{name}." for name in tables[key].builtin] if key in tables else [f"{key}="]
    return [key for key in keys if key.startswith(incomplete) and key != incomplete]


# options of several commands ----------------------------------------------------------------------

LOGS = "Logs"
LOOP = "Drive"
JUDGE = "Judge"
OUTPUT = "Output"
RUNNING = "Run"
"""The groups in which the options of `replan evaluate` are shown."""


def option(panel: str | None, words: str, *names: str, complete: str = "", **arguments: Any) -> Any:
    """A `typer.Option` in a group of the help.

    `panel`: the group; None: the default group. `names`: the spellings of the option; by default
    made from its parameter. `complete`: the names for shell completion: the name of a kind of part,
    or a key of `OTHER_NAMES`. `more`: further arguments of `typer.Option`.
    """
    if complete:
        arguments = {"metavar": "NAME", **arguments, "autocompletion": completion(complete)}
    make: Any = typer.Option
    return make(*names, rich_help_panel=panel, help=words, **arguments)


def planner_option(panel: str | None, words: str) -> Any:
    """The option --planner, -p of a command: planners to drive, or of a run the drives of these
    planners.
    """
    return option(panel, words, "--planner", "-p", complete="planner")


def log_option(panel: str | None, words: str) -> Any:
    """The option --log of a command: logs of a run by name or a part of it
    (`replan.results.load.named_logs`).
    """
    return option(panel, words, "--log", metavar="NAME")


def at_option(words: str) -> Any:
    """The option --at of a command: a time of a drive, s from the begin of its log."""
    return option(None, f"Time from the begin of the log, s. {words}", "--at", metavar="S")


def local_path(place: Path | None) -> Path | None:
    """The callback of an option or argument that names what a command writes: a URL ends the
    command.
    """
    try:
        return None if place is None else on_this_machine(place)
    # Not by `handle_errors`: what follows it is not interrupted any more
    except ConfigError as error:
        say_error(str(error))
        raise typer.Exit(2) from None


def output(words: str, *names: str) -> Any:
    """An option that names what a command writes, on this machine."""
    return option(None, words, *names, metavar="PATH", callback=local_path)


def out_option(words: str) -> Any:
    """The option --out, -o of a command that writes files of its own, on this machine."""
    return output(words, "--out", "-o")


def config_option(words: str) -> Any:
    """The option --config of a command that takes a part of a run's TOML file."""
    return option(None, words, "--config", metavar="FILE")


Loop = Literal["both", "open", "closed"]
OfLog = Annotated[
    str | None, log_option(None, "Drives of this log, or of the logs with this in the name.")
]
LogByPosition = Annotated[
    str | None,
    typer.Argument(metavar="[LOG]", help="As --log: a log of the run, or a part of its name."),
]


def only_log(by_position: str | None, by_option: str | None) -> str | None:
    """The log that is named by position or by --log; ConfigError if both name one."""
    if by_position is not None and by_option is not None:
        raise ConfigError("name the log once: by position, or with --log")
    return by_position if by_option is None else by_option


OfPlanner = Annotated[str | None, planner_option(None, "Drives of this planner.")]
OfMode = Annotated[Loop | None, option(None, "Drives in this loop. Default: both.", "--mode")]
Ego = Annotated[
    str | None, option(LOGS, "Take this road user of the log as the ego.", "--ego", metavar="ID")
]
Map = Annotated[
    Path | None, option(LOGS, "A map that replaces that of the log.", "--map", metavar="FILE")
]
Repair = Annotated[
    Literal["auto", "on", "off"] | None,
    option(LOGS, "Make tracks of raw detections: auto (if it has no tracks).", "--repair"),
]
Begin = Annotated[
    float | None, option(LOGS, "Begin this many seconds after the log does.", "--from", metavar="S")
]
End = Annotated[
    float | None, option(LOGS, "End this many seconds after the log begins.", "--to", metavar="S")
]
Suite = Annotated[
    str | None,
    option(
        LOGS,
        "Built-in logs: smoke, full, nightly, or a family or group.",
        "--suite",
        complete="suite",
    ),
]
Foxglove = Annotated[
    bool, option(OUTPUT, "Also write channels that Foxglove can draw.", "--foxglove")
]
Json = Annotated[
    bool, option(OUTPUT, "Write one JSON document, and nothing else, to stdout.", "--json")
]
Quiet = Annotated[
    bool,
    option(OUTPUT, "Print errors, each failure and the outcome only.", "--quiet", "-q"),
]
Settings = Annotated[Path | None, config_option("TOML file of a run: its \\[log] table.")]
Set = Annotated[
    list[str] | None,
    option(
        RUNNING,
        "Any other setting, by its key in the file; repeatable.",
        "--set",
        metavar="KEY=VALUE",
        autocompletion=complete_setting,
    ),
]
Gates = Annotated[
    Path | None,
    option(JUDGE, "TOML file of gates, or safety. Default: all packaged.", metavar="FILE"),
]
Workers = Annotated[
    int | None,
    option(RUNNING, "Processes; 0: this one. Default: one per core.", min=0, metavar="N"),
]
Config = Annotated[
    Path | None, option(RUNNING, "TOML file of settings; options win over it.", metavar="FILE")
]
Out = Annotated[
    Path | None,
    option(OUTPUT, "Result folder. Default: results/run-NNN.", "--out", "-o", metavar="FOLDER"),
]
Seed = Annotated[int, option(RUNNING, "Another seed, another search.", min=0, metavar="N")]
Resume = Annotated[bool, option(RUNNING, "Continue the interrupted search in --out.", "--resume")]
Metric = Annotated[
    list[str] | None,
    option(JUDGE, "A metric of your own, module:NAME; repeatable.", metavar="NAME"),
]
Engine = Annotated[
    Literal["local", "ray"],
    option(RUNNING, "Where logs are driven. Default: local.", show_default=False),
]
Address = Annotated[
    str | None,
    option(RUNNING, "Ray cluster (or auto). Default: one for this run.", metavar="HOST:PORT"),
]
Baseline = Annotated[
    Path | None, option(JUDGE, "A run, or file of replan baseline, to compare with.", metavar="RUN")
]
ListAgents = Annotated[bool, option(None, "List the agents, the nearest first.", "--list-agents")]
ListAxes = Annotated[bool, option(None, "List what can be varied.", "--list")]
NoReport = Annotated[
    bool, option(OUTPUT, "Write no report.html, report.md and junit.xml.", "--no-report")
]


def say_axes(*, as_json: bool) -> None:
    """Print what can be varied."""
    from replan.experiments.question import variation_table, variations

    say_json(variation_table()) if as_json else say("\n".join(variations()))


def say_agents(scenario: Scenario, *, as_json: bool) -> None:
    """Print the agents of a log, the nearest first."""
    from replan.experiments.ego_encounters import encounters, lines

    agents = encounters(scenario)
    say_json(agents) if as_json else say("\n".join(lines(agents, scenario.short_names)))


# options as a run's configuration -----------------------------------------------------------------


def run_config(
    config: Path | None, options: Mapping[str, Any], words: Sequence[str] = ()
) -> RunConfig:
    """The configuration of a run: the file, overridden by the options, overridden by the words of
    `--set`.

    `config`: a TOML file, or None. `options`: a table like that of the file; None and empty lists
    are options that were not given. `words`: "KEY=VALUE" each, with a dotted key and a TOML value;
    a value that is not TOML is taken as text. ConfigError if a key is unknown, a value is wrong, or
    the file cannot be read.
    """
    from replan.config import RunConfig, load_run
    from replan.core.settings import dotted_keys, merged, set_table

    changed = set_table(words)
    keys = list(dotted_keys(RunConfig))
    for key in changed:
        if not any(key == dotted_key.partition(".")[0] for dotted_key in keys):
            raise unknown_name("key", key, keys)
    return load_run(config, merged(_without_defaults(options), changed))


def _without_defaults(options: Mapping[str, Any]) -> dict[str, Any]:
    stated = {key: value for key, value in options.items() if value is not None and value != []}
    as_text = {key: str(value) for key, value in stated.items() if isinstance(value, Path)}
    tables = {
        key: _without_defaults(value) for key, value in stated.items() if isinstance(value, Mapping)
    }
    return {**stated, **as_text, **tables}


def log_table(
    ego: str | None,
    road_map: Path | None,
    begin: float | None,
    end: float | None,
    repair: str | None,
) -> dict[str, Any]:
    """The options about logs as the table [log] of a run."""
    return {"ego": ego, "map": road_map, "begin": begin, "end": end, "repair": repair}
