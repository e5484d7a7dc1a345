"""A wheel with machine code in it, so that nothing is compiled where it is installed:
`./dev wheel [FOLDER]`.

The wheel is built, unpacked, warmed up where it lies, and packed again under the names of this
Python and platform. Its kernels are for `replan.core.kernel.PORTABLE`, and the numba of this
environment; others compile, as without it.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZIP_DEFLATED, ZipFile


def main(out: Path) -> Path:
    """Build it into a folder; its path."""
    with TemporaryDirectory() as work:
        pure, tree = Path(work, "pure"), Path(work, "tree")
        pip = (
            sys.executable,
            "-m",
            "pip",
            "wheel",
            "--quiet",
            "--disable-pip-version-check",
            "--no-deps",
        )
        subprocess.run([*pip, "--wheel-dir", str(pure), "."], check=True)
        (wheel,) = pure.glob("*.whl")
        with ZipFile(wheel) as packed:
            packed.extractall(tree)
        warm(tree)
        return pack(tree, out)


def warm(tree: Path) -> None:
    """Compile all kernels of an unpacked wheel, beside its sources."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")
    }
    environment |= {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "replan", "warmup", "--all", "--json"]
    said = subprocess.run(
        command, cwd=tree, env=environment, check=True, stdout=subprocess.PIPE, text=True
    ).stdout
    done = json.loads(said)
    if not (done["compiled"] and Path(done["folder"]).is_relative_to(tree.resolve())):
        raise SystemExit(f"error: no kernels beside the sources: {said}")


def pack(tree: Path, out: Path) -> Path:
    """A wheel of all files of a tree, with machine code of this Python and platform."""
    (info,) = tree.glob("*.dist-info")
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    tag = f"{python}-{python}-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
    kept = [
        line
        for line in (info / "WHEEL").read_text().splitlines()
        if not line.startswith(("Root-", "Tag:"))
    ]
    about = "\n".join([*filter(None, kept), "Root-Is-Purelib: false", f"Tag: {tag}", ""])
    (info / "WHEEL").write_text(about)
    (info / "RECORD").unlink()
    files = sorted(file for file in tree.rglob("*") if file.is_file())
    out.mkdir(parents=True, exist_ok=True)
    wheel = out / f"{info.name.removesuffix('.dist-info')}-{tag}.whl"
    with ZipFile(wheel, "w", ZIP_DEFLATED, compresslevel=9) as packed:
        record = f"{info.name}/RECORD"
        rows = [_added(packed, file, file.relative_to(tree).as_posix()) for file in files]
        packed.writestr(record, "\n".join([*rows, f"{record},,", ""]))
    return wheel


def _added(packed: ZipFile, file: Path, name: str) -> str:
    """Add a file; its row of RECORD."""
    packed.write(file, name)
    digest = (
        base64.urlsafe_b64encode(hashlib.sha256(file.read_bytes()).digest()).rstrip(b"=").decode()
    )
    return f"{name},sha256={digest},{file.stat().st_size}"


if __name__ == "__main__":
    made = main(Path(*sys.argv[1:2] or ["dist"]))
    sys.stdout.write(f"{made} ({made.stat().st_size / 1e6:.1f} MB)\n")
