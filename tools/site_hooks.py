"""Hooks of the docs site: pages of the root, links to sources, formulas as MathML, search from files.

The repository's own pages are used as they are: those of the root become pages of the site, and links to
files that are no pages become their names. Formulas are MathML, which browsers draw without a script.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File

# MkDocs takes a README for the index of its folder, which is another page.
ROOT_PAGES = {
    "README.md": "project.md",
    "ARCHITECTURE.md": "ARCHITECTURE.md",
    "CONTRIBUTING.md": "CONTRIBUTING.md",
    "SECURITY.md": "SECURITY.md",
    "CHANGELOG.md": "CHANGELOG.md",
}
ROOT = Path(__file__).resolve().parent.parent

LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
FENCE = re.compile(r"(?ms)(^[ \t]*```.*?^[ \t]*```[ \t]*$|`[^`\n]+`)")


def on_files(files: Any, config: Any) -> Any:
    """Add the pages of the root."""
    for name, page in ROOT_PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text("utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Rewrite links that leave the folder of the pages."""
    uri = page.file.src_uri
    where = "" if uri in ROOT_PAGES.values() else posixpath.join("docs", posixpath.dirname(uri))
    here = posixpath.dirname(uri)
    known = {file.src_uri for file in files}

    def rewritten(match: re.Match[str]) -> str:
        mark, text, target = match.groups()
        path, _, anchor = target.partition("#")
        if "://" in target or not path:
            return match[0]
        place = posixpath.normpath(posixpath.join(where, path))
        site = place.removeprefix("docs/") if place.startswith("docs/") else ROOT_PAGES.get(place)
        if site in known:
            relative = posixpath.relpath(site, here or ".")
            return f"{mark}[{text}]({relative}{'#' + anchor if anchor else ''})"
        if not (ROOT / place).exists():
            # Left as it is, so that MkDocs warns.
            return match[0]
        # A source or a folder, which is no page.
        return f"`{text}`" if "`" not in text and re.search(r"[/.]", text) else text

    parts = FENCE.split(markdown)
    # Code spans and fences are the odd parts; links may hold a span, so that they are put together first.
    held: list[str] = []

    def hold(code: str) -> str:
        held.append(code)
        return f"\x00{len(held) - 1}\x00"

    text = "".join(hold(part) if index % 2 else part for index, part in enumerate(parts))
    text = LINK.sub(rewritten, text)
    return re.sub(r"\x00(\d+)\x00", lambda found: held[int(found[1])], text)


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Let the search run where pages are opened as files: before the theme starts its worker."""
    shim = posixpath.relpath("assets/search-from-files.js", posixpath.dirname(page.file.dest_uri) or ".")
    return re.sub(
        r'(<script src="[^"]*bundle\.[^"]*"></script>)', rf'<script src="{shim}"></script>\1', output
    )


@event_priority(-100)
def on_post_build(config: Any) -> None:
    """Write the search index as a script: pages that are opened as files may read no other kind of file."""
    folder = Path(config.site_dir) / "search"
    index = (folder / "search_index.json").read_text("utf-8")
    (folder / "search_index.js").write_text(f"var __index = {index}", "utf-8")


def on_page_content(html: str, page: Any, config: Any, files: Any) -> str:
    """Turn formulas into MathML."""

    def formula(match: re.Match[str]) -> str:
        block = match[1] == "div"
        latex = match[2].strip()
        for sign, entity in (("&", "&amp;"), ("<", "&lt;"), (">", "&gt;")):
            latex = latex.replace(entity, sign)
        latex = latex.removeprefix("\\[").removesuffix("\\]").removeprefix("\\(").removesuffix("\\)")
        return str(convert(latex.strip(), display="block" if block else "inline"))

    return re.sub(r'(?s)<(div|span) class="arithmatex">(.*?)</\1>', formula, html)
