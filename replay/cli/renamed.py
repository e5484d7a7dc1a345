"""Options of the last version that have another name now: they are still taken, with a hint on stderr.

They go with the next version.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from typer.core import TyperCommand

EVALUATE: Mapping[str, str] = {
    "--trust": "loop.apart.trust=true",
    "--plan-timeout": "loop.apart.plan_timeout_s={}",
    "--log-timeout": "loop.apart.log_timeout_s={}",
    "--planner-memory": "loop.apart.memory_gb={}",
    "--batch": "loop.apart.batch={}",
    "--internals": "internals={}",
    "--deadline": "deadline_s={}",
    "--plant": "loop.plant.{}",
    "--end-with-evidence": "loop.end_with_evidence=true",
}
"""Options of `replan evaluate`, and what `--set` takes in their place; {} is the option's value."""
COMPARE = {"--no-partings": "--no-first-difference"}
"""Options of `replan compare`, and their new names."""


class EvaluateCommand(TyperCommand):
    """`replan evaluate`, which also takes the options in `EVALUATE`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The words with the old options replaced, parsed."""
        left: list[str] = super().parse_args(ctx, list(replaced(args, EVALUATE)))
        return left


class CompareCommand(TyperCommand):
    """`replan compare`, which also takes the options in `COMPARE`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The words with the old options replaced, parsed."""
        from replay.cli.app import say

        for old in COMPARE.keys() & set(args):
            say(f"hint: {old} is now {COMPARE[old]}; the old option goes with the next version", err=True)
        left: list[str] = super().parse_args(ctx, [COMPARE.get(word, word) for word in args])
        return left


def replaced(words: Sequence[str], table: Mapping[str, str]) -> Iterator[str]:
    """The words of a command line in which the old options of a table are `--set KEY=VALUE`; hints go to stderr."""
    from replay.cli.app import say

    left = iter(words)
    for word in left:
        option, equals, value = word.partition("=")
        if option not in table:
            yield word
            if word == "--":
                yield from left
            continue
        setting = table[option]
        if "{}" in setting:
            given: Any = value if equals else next(left, None)
            if given is None:  # click says that there is no such option
                yield word
                return
            setting = setting.format(given)
        say(f"hint: {option} is now --set {setting}; the old option goes with the next version", err=True)
        yield from ("--set", setting)
