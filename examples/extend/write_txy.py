"""Write a log for the reader."""

from pathlib import Path

Path("drive.txy").write_text(
    "".join(f"{0.1 * k:.1f} {k:.1f} 0.0 0.0\n" for k in range(30)), encoding="utf-8"
)
