"""The wheel with machine code: what `.ci/wheel.py` packs can be installed, and says for which
Python it is.
"""

import base64
import csv
import hashlib
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ABOUT = "Wheel-Version: 1.0\nGenerator: any\nRoot-Is-Purelib: true\nTag: py3-none-any\n"


@pytest.mark.slow
def test_a_wheel_with_machine_code_is_for_one_python_and_platform_and_records_all_its_files(
    tmp_path: Path,
) -> None:
    pack = runpy.run_path(".ci/wheel.py")["pack"]
    files = {"one/__init__.py": b"", "one/__pycache__/one.f-1.py311.1.nbc": bytes(range(256))}
    files |= {"one-1.0.dist-info/WHEEL": ABOUT.encode(), "one-1.0.dist-info/RECORD": b"stale,,\n"}
    files |= {"one-1.0.dist-info/METADATA": b"Metadata-Version: 2.1\nName: one\nVersion: 1.0\n"}
    for name, content in files.items():
        (tmp_path / "tree" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tree" / name).write_bytes(content)
    wheel = pack(tmp_path / "tree", tmp_path / "dist")
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert re.fullmatch(rf"one-1\.0-{python}-{python}-\w+\.whl", wheel.name)
    there = tmp_path / "there"
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--no-index",
        "--no-deps",
        "--no-compile",
        "--target",
    ]
    subprocess.run([*pip, str(there), str(wheel)], check=True, capture_output=True)
    rows = list(csv.reader((there / "one-1.0.dist-info/RECORD").read_text().splitlines()))
    recorded = {name: digest for name, digest, _ in rows}
    assert recorded.keys() >= files.keys() and "stale" not in recorded
    for name in files.keys() - {"one-1.0.dist-info/RECORD"}:
        made = (
            base64.urlsafe_b64encode(hashlib.sha256((there / name).read_bytes()).digest())
            .rstrip(b"=")
            .decode()
        )
        assert recorded[name] == f"sha256={made}"
    about = (there / "one-1.0.dist-info/WHEEL").read_text()
    assert f"Tag: {python}-{python}-" in about and "any" not in about.partition("Tag")[2]
    assert "Root-Is-Purelib: false" in about
