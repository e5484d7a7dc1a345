"""docs/architecture.md lists the files on the way of one log; one run is traced to hold it to that."""

import json
import re
import subprocess
import sys
from pathlib import Path

from short_logs import short

from logs.mcap import write_scenario

ROOT = Path(__file__).parents[2]
MOST_FILES = 25
TRACED = """
import json, sys
import replay.draw.recording, replay.draw.report, replay.run
from replay.cli import app

ROOT, found = sys.argv[1], {}
PACKAGES = ("logs/", "metrics/", "planners/", "replay/")


def ours(frame):
    name = frame.f_code.co_filename.removeprefix(ROOT)
    return name if name.startswith(PACKAGES) and frame.f_code.co_name != "<module>" else ""


def called(frame, event, _):
    if event == "call" and (file := ours(frame)) and file not in found:
        found[file], caller = set(), frame.f_back
        while caller is not None:
            found[file].add(ours(caller))
            caller = caller.f_back


sys.setprofile(called)
try:
    app(sys.argv[2:], prog_name="replan")
except SystemExit as end:
    code = end.code
sys.setprofile(None)
print(json.dumps({"code": code, "found": {file: sorted(callers - {""}) for file, callers in found.items()}}))
"""


def test_the_way_of_one_log_is_the_files_that_the_page_lists(tmp_path: Path) -> None:
    """Law: each listed file is called, and between the command and its first call there are listed files only."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    steps = page[page.index("## One log through") : page.index("## Where is")]
    listed = set(re.findall(r"`([\w/]+\.py)`", steps))
    assert len(listed) <= MOST_FILES and f"is {len(listed)} files" in steps
    write_scenario(tmp_path / "a.mcap", short("test/a", parked=True))
    command = ["evaluate", str(tmp_path / "a.mcap"), "--out", str(tmp_path / "out"), "--workers", "0"]
    python = [sys.executable, "-c", TRACED, f"{ROOT}/"]
    done = subprocess.run([*python, *command], cwd=ROOT, capture_output=True, text=True, check=True)
    run = json.loads(done.stdout.splitlines()[-1])
    assert run["code"] in (0, 1, 4), done.stderr
    assert listed <= run["found"].keys()
    on_the_way = {caller for file in listed for caller in run["found"][file]}
    assert on_the_way <= listed, on_the_way - listed
