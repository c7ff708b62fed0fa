"""The modules of every crate, and of the Python package, import each other in one direction."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

CRATES = Path(__file__).parent.parent / "crates"
SOURCES = sorted(folder for folder in CRATES.glob("*/src") if folder.is_dir())
NAME = r"\w+(?:::\w+)*"


def modules(source: Path) -> dict[str, Path]:
    """Module path to file, without tests."""
    found = {}
    for file in source.rglob("*.rs"):
        parts = list(file.relative_to(source).with_suffix("").parts)
        if "tests" in parts or "test" in parts:
            continue
        if parts[-1] == "mod":
            parts.pop()
        found["::".join(parts)] = file
    return found


def imports(name: str, file: Path, known: dict[str, Path]) -> set[str]:
    """Modules of the same crate that a file names, in `use` lines or in paths.

    A module that only re-exports what its children have does not import them.
    """
    text = file.read_text().split("#[cfg(test)]\nmod tests")[0]
    text = re.sub(r"//[^\n]*", "", text)
    paths = set()
    for root, path in re.findall(rf"\b(crate|super|self)::((?:super::)*{NAME})", text):
        above = name.split("::")
        if root == "super":
            above = above[:-1]
        while path.startswith("super::"):
            path, above = path.removeprefix("super::"), above[:-1]
        paths.add("::".join([*([] if root == "crate" else above), path]))
    for root, group in re.findall(r"\buse (crate|super|self)::\{([^;]*)\};", text):
        above = {"crate": [], "super": name.split("::")[:-1], "self": name.split("::")}[root]
        paths.update("::".join([*above, path]) for path in re.findall(NAME, group))
    own = re.sub(r"\bpub(?:\([^)]*\))? use [^;]*;", "", text)
    for child in re.findall(r"\bmod (\w+);", text):
        if re.search(rf"(?<![\w:]){child}::", own):
            paths.add(f"{name}::{child}")
    found = set()
    for path in paths:
        parts = path.split("::")
        while parts and "::".join(parts) not in known:
            parts.pop()
        found.add("::".join(parts))
    return found - {"", name, "lib", "main"}


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that reach each other."""
    reach: dict[str, set[str]] = {}
    for start in graph:
        seen: set[str] = set()
        stack = list(graph[start])
        while stack:
            name = stack.pop()
            if name not in seen:
                seen.add(name)
                stack.extend(graph.get(name, ()))
        reach[start] = seen
    groups = {frozenset({a, *(b for b in reach[a] if a in reach.get(b, ()))}) for a in graph if a in reach[a]}
    return sorted(sorted(group) for group in groups)


def graph_of(source: Path) -> dict[str, set[str]]:
    known = modules(source)
    return {name: imports(name, file, known) for name, file in known.items() if name not in {"lib", "main"}}


def test_every_crate_is_read() -> None:
    assert {"evis-core", "evis-render", "evis-py"} <= {source.parent.name for source in SOURCES}


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.parent.name)
def test_no_circle_of_imports(source: Path) -> None:
    assert circles(graph_of(source)) == []


def python_graph(folder: Path) -> dict[str, set[str]]:
    """Imports of a package's modules, those inside functions too; those for type checkers alone left out."""
    known = {file.stem for file in folder.glob("*.py")} - {"__init__", "__main__"}
    graph: dict[str, set[str]] = {name: set() for name in known}

    def visit(name: str, node: ast.AST) -> None:
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            return
        if isinstance(node, ast.ImportFrom) and node.level == 1:
            parents = [node.module] if node.module else [alias.name for alias in node.names]
            graph[name].update(known.intersection(parent.split(".")[0] for parent in parents))
        for child in ast.iter_child_nodes(node):
            visit(name, child)

    for name in known:
        visit(name, ast.parse((folder / f"{name}.py").read_text("utf-8")))
    return graph


def test_no_circle_of_imports_in_python(tmp_path: Path) -> None:
    graph = python_graph(CRATES.parent / "python" / "evis")
    assert "_events" in graph["torch"]
    assert circles(graph) == []
    # Canary: one that is closed inside a function.
    (tmp_path / "a.py").write_text("from .b import f")
    (tmp_path / "b.py").write_text("def f():\n    from . import a")
    assert circles(python_graph(tmp_path)) == [["a", "b"]]


def test_a_circle_is_found(tmp_path: Path) -> None:
    # Canary: a parent and its child.
    (tmp_path / "a").mkdir()
    (tmp_path / "a.rs").write_text("mod b;\npub use b::One;\nuse b::Two;\npub struct Three;")
    (tmp_path / "a" / "b.rs").write_text("use super::Three;")
    assert circles(graph_of(tmp_path)) == [["a", "a::b"]]
    (tmp_path / "a.rs").write_text("mod b;\npub use b::One;\npub struct Three;")
    assert circles(graph_of(tmp_path)) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
    assert circles({"a": {"b"}, "b": set()}) == []


@pytest.mark.parametrize("crate", ["evis-render", "evis-decoupled"])
def test_folders_import_those_above_them(crate: str) -> None:
    """In the order of the table in `lib.rs`."""
    source = CRATES / crate / "src"
    table = re.findall(r"^//! \| \[?`([a-z]+)`\]? +\|", (source / "lib.rs").read_text(), re.MULTILINE)
    graph = graph_of(source)
    folders = {name.split("::")[0] for name in graph} - {"error", "hash"}
    assert set(table) == folders
    wrong = sorted(
        f"{name} imports {other}"
        for name, others in graph.items()
        for other in others
        if name.split("::")[0] in table
        and other.split("::")[0] in table
        and table.index(other.split("::")[0]) > table.index(name.split("::")[0])
    )
    assert wrong == []
