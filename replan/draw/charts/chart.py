"""A chart: SVG elements with a size, a title and a sentence, as a part of a page or as a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from replan.core.errors import ConfigError, writing
from replan.draw.charts.style import Theme, stylesheet
from replan.draw.charts.svg import group, printable, px
from replan.results.tables import write_png, write_text

FORMATS = (".png", ".svg")


@dataclass(frozen=True)
class Chart:
    """A picture.

    Attributes:
        name: One word; the last part of the file name.
        title: What the chart shows, with the unit if there is only one.
        says: A description in one sentence, for screen readers.
        width: Pixels; `height` likewise.
        body: SVG elements.
    """

    name: str
    title: str
    says: str
    width: float
    height: float
    body: str

    def _repr_html_(self) -> str:
        """The chart in a notebook."""
        return self.alone("light")

    def inline(self) -> str:
        """The chart as an SVG element for an HTML page that contains the style sheet."""
        return (
            f'<svg class="chart" viewBox="0 0 {px(self.width)} {px(self.height)}" role="img" '
            f'aria-label="{escape(printable(self.says))}">{self.body}</svg>'
        )

    def alone(self, theme: Theme, width: float | None = None) -> str:
        """The chart as the text of an SVG file, with its own width or with `width` pixels."""
        wide = width or self.width
        size = f'width="{wide:g}" height="{wide * self.height / self.width:.6g}"'
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" class="chart" {size} '
            f'viewBox="0 0 {px(self.width)} '
            f'{px(self.height)}"><title>{escape(printable(self.title))}</title>'
            f"<desc>{escape(printable(self.says))}</desc><style>{stylesheet(theme)}</style>"
            f'<rect class="ground" width="100%" height="100%"/>{self.body}</svg>\n'
        )

    def save(self, path: Path | str, *, theme: Theme = "light", width: float | None = None) -> None:
        """Write the picture in the format of the path's suffix. The same picture gives the same
        bytes.

        Args:
            path: The file; it ends with .png or .svg.
            theme: "auto" is light in a PNG, which cannot follow the system of its reader.
            width: Pixels; None: half as many again as the chart has.

        Raises:
            ConfigError: The suffix is neither .png nor .svg.
            OutputError: The file cannot be written.
        """
        path = Path(path)
        if path.suffix not in FORMATS:
            raise ConfigError(f"{path}: a picture ends with .png or .svg")
        wide = width or 1.5 * self.width
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix == ".svg":
                write_text(path, self.alone(theme, wide))
                return
            import resvg_py

            fonts = [
                str(Path(__file__).with_name("fonts") / f"DejaVuSans{style}.ttf")
                for style in ("", "-Bold")
            ]
            svg = self.alone("light" if theme == "auto" else theme, wide)
            data = bytes(
                resvg_py.svg_to_bytes(
                    svg_string=svg,
                    skip_system_fonts=True,
                    font_files=fonts,
                    font_family="DejaVu Sans",
                )
            )
            write_png(path, data)


def stacked(charts: Sequence[Chart], name: str, title: str, says: str) -> Chart:
    """Charts below each other, as one."""
    body, y = "", 0.0
    for chart in charts:
        body, y = body + group(0.0, y, chart.body), y + chart.height
    return Chart(name, title, says, max(chart.width for chart in charts), y, body)
