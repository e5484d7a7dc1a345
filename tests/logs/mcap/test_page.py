"""docs/log_format.md says what the messages are."""

from __future__ import annotations

from pathlib import Path

import msgspec

from logs.mcap import native
from logs.mcap.native import markdown

PAGE = (Path(__file__).parents[3] / "docs" / "log_format.md").read_text(encoding="utf-8")


def test_the_page_is_written_from_the_types() -> None:
    assert markdown() + "\n" == PAGE, "python -c 'from logs.mcap.native import markdown; print(markdown())'"


def test_every_field_of_every_topic_is_on_the_page() -> None:
    for topic, kind in native.TOPICS.items():
        assert f"| `{topic}` | [{kind.__name__}]" in PAGE
        _, _, section = PAGE.partition(f"### {kind.__name__}\n")
        section = section.partition("\n### ")[0]
        for field in msgspec.structs.fields(kind):
            needed = "needed" if field.required else "optional"
            (row,) = (line for line in section.splitlines() if line.startswith(f"| `{field.encode_name}` |"))
            assert row.endswith(f"| {needed} |")
