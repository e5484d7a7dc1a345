"""What the site needs beyond its pages: mathematics as MathML, and the files of the repository that
pages link to.

Both happen while it is built, so that a page asks nothing of any host; a page that would is an
error.

- `$...$` in a line and a fence `math` are TeX, as on GitHub.
- A link that leads out of docs/ (`../planners/base.py`) leads to a page with that file;
  to a folder, to its list of files.
"""

from __future__ import annotations

import ast
import json
import posixpath
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
OUTWARD = re.compile(r"\]\(((?:\.\./)+[^)#\s]+)(#[^)\s]*)?\)")
LOADED = re.compile(
    r"""<(?:script|img|iframe|source|link rel="(?:stylesheet|preconnect)")[^>]*(?:src|href)="?(?:https?:)?//[^>]*>"""  # noqa: E501
)
FENCES = {
    ".py": "python",
    ".toml": "toml",
    ".yml": "yaml",
    ".cpp": "cpp",
    ".hpp": "cpp",
    ".json": "json",
    ".txt": "",
}


class Mathematics(InlineProcessor):
    """`$x$` as MathML."""

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str, int, int]:  # noqa: N802, D102
        return self.md.htmlStash.store(convert(m.group(1))), m.start(0), m.end(0)


class MathematicsExtension(Extension):
    """`$x$` in the text; within code it stays what it is."""

    def extendMarkdown(self, md: Any) -> None:  # noqa: N802, D102
        md.inlinePatterns.register(
            Mathematics(r"(?<![\\$\w])\$(?![\s$])([^$\n]+?)(?<![\s\\])\$(?!\w)", md),
            "mathematics",
            185,
        )


def display(source: str, *_: Any, **__: Any) -> str:
    """A fence `math` as a displayed equation."""
    return convert(source.strip(), display="block")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Mathematics is known to Markdown."""
    config.markdown_extensions.append(MathematicsExtension())
    config.mdx_configs["pymdownx.superfences"] = {
        "custom_fences": [{"name": "math", "class": "math", "format": display}]
    }
    return config


def target(source: str, link: str) -> str:
    """The file of the repository that a link of a page in docs/ leads to, from the root."""
    return posixpath.normpath(posixpath.join("docs", posixpath.dirname(source), link))


def page_of(path: str) -> str:
    """The page that shows a file of the repository."""
    return f"source/{path.strip('.')}.md"


def first_line(path: Path) -> str:
    """What a module says it is."""
    doc = (
        ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
        if path.suffix == ".py"
        else None
    )
    return (doc or "").partition("\n")[0]


def rooted(markdown: str, path: str) -> str:
    """The text of a page of the repository, its links to docs/ leading there, the others gone."""

    def there(m: re.Match[str]) -> str:
        goal = posixpath.normpath(posixpath.join(posixpath.dirname(path), m.group(2)))
        if not goal.startswith("docs/"):
            return f"**{m.group(1)}**"
        return f"[{m.group(1)}]({posixpath.relpath(goal[5:], posixpath.dirname(page_of(path)))})"

    return re.sub(r"\[([^\]]+)\]\((?!https?:)([^)\s]+)\)", there, markdown)


def source_page(path: str) -> str:
    """A file as a page; of a folder the list of its modules."""
    head = f"---\ntitle: {path}\nsearch:\n  exclude: true\n---\n# {path}\n\n"
    place = ROOT / path
    if place.is_dir():
        rows = [
            f"| {p.relative_to(place)} | {first_line(p).replace('|', '/')} |"
            for p in sorted(place.rglob("*.py"))
        ]
        return head + "\n".join(["| file | what |", "|---|---|", *rows]) + "\n"
    text = place.read_text(encoding="utf-8")
    if place.suffix == ".md":
        return head.rpartition("# ")[0] + rooted(text, path)
    if place.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        parts = [(cell["cell_type"], "".join(cell["source"])) for cell in cells]
        body = "\n\n".join(
            said if kind == "markdown" else f"```python\n{said}\n```" for kind, said in parts
        )
        return head + rooted(body, path) + "\n"
    return f"{head}`````{FENCES.get(place.suffix, '')}\n{text}\n`````\n"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Every file that a page links to outside of docs/ is a page of the site."""
    wanted = {
        target(page.src_uri, m.group(1))
        for page in list(files.documentation_pages())
        for m in OUTWARD.finditer(page.content_string)
    }
    for path in sorted(wanted):
        if (ROOT / path).exists():
            file = File.generated(
                config,
                page_of(path),
                content=source_page(path),
                inclusion=InclusionLevel.NOT_IN_NAV,
            )
            files.append(file)
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Links that lead out of docs/ lead to the pages of those files."""
    if page.file.src_uri.startswith("source/"):
        return markdown

    def there(m: re.Match[str]) -> str:
        path = target(page.file.src_uri, m.group(1))
        here = posixpath.dirname(page.file.src_uri)
        return f"]({posixpath.relpath(page_of(path), here or '.')}{m.group(2) or ''})"

    return OUTWARD.sub(there, markdown)


def on_post_page(output: str, page: Page, **_: Any) -> str:
    """No page loads anything from elsewhere."""
    if found := LOADED.search(output):
        raise PluginError(f"{page.file.src_uri} loads from elsewhere: {found.group(0)[:120]}")
    return output
