"""The command line as tests call it."""

from pathlib import Path

from typer.testing import CliRunner, Result

from replan.cli import app

RUNNER = CliRunner(env={"COLUMNS": "200", "TERM": "dumb", "NO_COLOR": "1"})


def replan(*words: object) -> Result:
    """`replan WORDS`; any exception that is not an exit is raised."""
    result = RUNNER.invoke(app, [str(word) for word in words])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def evaluate(*words: object) -> Result:
    """Quickly: in this process, no recordings, the smallest planner where none is named."""
    planner = () if "--planner" in words else ("--planner", "constant_speed")
    return replan("evaluate", *words, *planner, "--workers", 0, "--no-recording")


def gates(path: Path, *rules: str) -> Path:
    path.write_text("\n".join(f"[[gate]]\n{rule}" for rule in rules), encoding="utf-8")
    return path


def one_error(result: Result) -> str:
    """The only line on stderr that is an error."""
    lines = [line for line in result.stderr.splitlines() if line.startswith("error:")]
    assert len(lines) == 1, result.stderr
    assert "Traceback" not in result.stderr
    return lines[0]
