"""Documents and comments name what exists: paths of files, command-line options, Rust paths and symbols."""

from __future__ import annotations

import os
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BUILT = {"target", "node_modules", "__pycache__", "dist", "out"}
"""Folders that hold no sources; hidden ones are left out too, but for ``.ci``."""

# Options of other programs that documents and messages show, by program.
OTHER_OPTIONS = {
    "Blender": {"--background", "--python"},
    "cargo": {
        "--bench",
        "--example",
        "--lib",
        "--locked",
        "--path",
        "--profile",
        "--release",
        "--sanitizer",
        "--test",
        "--workspace",
    },
    "cargo's test harness": {"--nocapture"},
    "clap, in a comment on its messages": {"--flag"},
    "crates/evis-render/benches/native.rs": {"--memory-of-seconds"},
    "git": {"--always", "--dirty", "--git-path", "--short"},
    "mypy": {"--strict"},
    "ray": {"--head"},
    "v2e": {
        "--dvs1024",
        "--dvs128",
        "--dvs240",
        "--dvs346",
        "--dvs640",
        "--hdr",
        "--input",
        "--overwrite",
        "--scidvs",
    },
}

# Files of other projects that comments cite, by project.
OTHER_PATHS = {
    "dv-processing": {"aedat2_output.py"},
    "v2e": {"emulator_utils.py", "v2e.py", "v2ecore/v2e_args.py"},
    "wgpu-hal": {"dx12/adapter.rs", "metal/adapter.rs", "vulkan/adapter.rs"},
}

# Types of other projects that comments cite, by project.
OTHER_SYMBOLS = {
    "AEDAT": {"FlatBuffers"},
    "jAER": {"Davis240", "Davis346"},
}

OPTION = r"(?<![\w-])--[a-z][a-z0-9]*(?:-[a-z0-9]+)*(?![\w-])"
TOKEN = r"(?<![\w/.<{*:-])\.?[\w{][\w./{},*-]*"
IDENTIFIER = r"[A-Za-z_][A-Za-z0-9_]*"


# What the repository holds.


@cache
def files() -> tuple[str, ...]:
    """Every file of the repository, relative to its root."""
    found = []
    for folder, below, names in os.walk(ROOT):
        below[:] = [b for b in below if b not in BUILT and (b == ".ci" or not b.startswith("."))]
        found += [Path(folder, name).relative_to(ROOT).as_posix() for name in names]
    return tuple(found)


@cache
def endings() -> frozenset[str]:
    """Every file and folder, by each way to end its path: ``c``, ``b/c`` and ``a/b/c``."""
    found: set[str] = set()
    for file in files():
        parts = file.split("/")
        for end in range(1, len(parts) + 1):
            found.update("/".join(parts[begin:end]) for begin in range(end))
    # A link: the same folder by a shorter way.
    found.update(f"shaders/{file.split('/shaders/')[1]}" for file in files() if "/shaders/" in file)
    return frozenset(found | {"shaders"})


@cache
def read(file: str) -> str:
    return (ROOT / file).read_text("utf-8")


@cache
def named(suffix: str, under: str = "") -> tuple[str, ...]:
    return tuple(file for file in files() if file.endswith(suffix) and file.startswith(under))


@cache
def documents() -> tuple[str, ...]:
    """What users and contributors read; the change log and the notes tell of what was."""
    pages = [page for page in named(".md", "docs/") if not page.startswith("docs/notes/")]
    return ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "SECURITY.md", *pages)


def sources() -> list[str]:
    own = Path(__file__).resolve().relative_to(ROOT).as_posix()
    return [file for end in (".rs", ".wgsl", ".py", ".pyi") for file in named(end) if file != own]


@cache
def without_comments(text: str) -> str:
    return re.sub(r"(?m)//.*$", "", text)


@cache
def comments(file: str) -> str:
    """The comments of a source, and the docstrings of Python, each line on its own."""
    text = read(file)
    if file.endswith((".py", ".pyi")):
        strings = re.findall(r'r?"""(.*?)"""', text, re.DOTALL)
        return "\n".join(strings + re.findall(r"(?m)(?:^|\s)#\s(.*)$", text))
    return "\n".join(re.findall(r"(?m)(?:^|\s)//[/!]?(.*)$", text))


@cache
def code_words() -> frozenset[str]:
    """Every identifier in code, comments left out, and in what builds it."""
    found: set[str] = set()
    for file in sources():
        text = read(file) if file.endswith((".py", ".pyi")) else without_comments(read(file))
        found.update(re.findall(IDENTIFIER, text))
    for file in ("Makefile", ".ci/run", "tools/setup", "tools/install", "tools/smoke", "pyproject.toml"):
        found.update(re.findall(IDENTIFIER, read(file)))
    return frozenset(found)


# Paths.


def expanded(path: str) -> list[str]:
    """``a/{b,c}.rs`` is ``a/b.rs`` and ``a/c.rs``."""
    found = re.search(r"\{([^{}]*)\}", path)
    if not found:
        return [path]
    return [
        e
        for part in found[1].split(",")
        for e in expanded(path[: found.start()] + part + path[found.end() :])
    ]


def is_path(token: str) -> bool:
    """Whether a word names a file or a folder of this repository, existing or not."""
    if "://" in token or token in set().union(*OTHER_PATHS.values()):
        return False
    if re.search(r"[\w}*]\.(rs|wgsl|pyi?)$", token):
        return not token.endswith("evis-rs")
    first = token.split("/")[0]
    roots = {"crates", "shaders", "src", "tests", "docs", "python", "tools", "examples", "benches", ".ci"}
    return "/" in token and first in roots


def exists(path: str) -> bool:
    path = path.rstrip("/")
    if "*" in path:
        pattern = re.compile(r"(.*/)?" + re.escape(path).replace(r"\*\*", ".*").replace(r"\*", "[^/]*"))
        return any(pattern.fullmatch(known) for known in endings())
    return path in endings()


def wrong_paths(text: str) -> list[str]:
    """Paths in a text that lead nowhere."""
    tokens = {token.rstrip(".,-") for token in re.findall(TOKEN, text)}
    paths = [token for token in tokens if ("/" in token or "." in token) and is_path(token)]
    return sorted({path for token in paths for path in expanded(token) if not exists(path)})


def quoted(text: str) -> str:
    """The code spans and link targets of a Markdown page, a line each; fenced blocks whole."""
    fenced = re.findall(r"(?ms)^```\w*(?: [^\n]*)?\n(.*?)^```", text)
    rest = re.sub(r"(?ms)^```.*?^```", "", text)
    links = [target.split("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", rest) if "://" not in target]
    return "\n".join([*re.findall(r"`([^`\n]+)`", rest), *links, *fenced])


# Links.


def anchors(text: str) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"(?ms)^```.*?^```", "", text)
    headings = re.findall(r"(?m)^#+ +(.*?) *$", text)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain}


def wrong_links(text: str, page: str) -> list[str]:
    """Relative links of a page to files or headings that do not exist."""
    wrong = []
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        target, _, anchor = link.partition("#")
        file = (ROOT / page).parent / target if target else ROOT / page
        if "://" in link or link.startswith("mailto:"):
            continue
        if not file.exists() or (
            anchor and anchor not in anchors(text if not target else file.read_text("utf-8"))
        ):
            wrong.append(link)
    return wrong


# Options.


def declared(text: str) -> set[str]:
    """Options that clap makes of a source: of ``long = "name"``, else of the field's name."""
    found = {f"--{name}" for name in re.findall(r'\blong = "([a-z0-9-]+)"', text)}
    attribute = r"#\[arg\((?:[^\]]*[\s,(])?long(?!\s*=)(?=[,)\s])(?:[^\[\]]|\[[^\]]*\])*\)\]\s*(?:///.*\s*|#\[.*\]\s*)*"
    for field in re.findall(attribute + r"(?:pub(?:\(crate\))? )?([a-z_0-9]+):", text):
        found.add("--" + field.replace("_", "-"))
    return found


@cache
def known_options() -> frozenset[str]:
    found = {"--help", "--version"}
    for file in named(".rs", "crates/evis-cli/src/"):
        found |= declared(read(file))
    found |= set(re.findall(OPTION, read("python/evis/_commands.py")))
    for file in ("Makefile", ".ci/run", *(f for f in files() if f.startswith(("tools/", "benches/")))):
        found |= set(re.findall(OPTION, read(file)))
    return frozenset(found.union(*OTHER_OPTIONS.values()))


def options_in_messages(text: str) -> list[str]:
    """Return options that string literals name, but for those of whole commands between backticks."""
    text = re.split(r"#\[cfg\(test\)\]\s*(?:#\[[^\n]*\]\s*)*mod tests", text)[0]
    text = re.sub(r"(?m)(?:^|\s)//.*$|^\s*#.*$", "", re.sub(r'"""(?s:.*?)"""', "", text))
    literals = re.findall(r'"((?:[^"\\]|\\.)*)"', text, re.DOTALL)
    return [
        option
        for literal in literals
        for option in re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", re.sub(r"`[^`]* [^`]*`", "", literal))
    ]


# What makes command lines, and the commands themselves.
COMMAND_LINES = (
    "crates/evis-chart/src/ladder.rs",
    "crates/evis-chart/src/recommend.rs",
    "crates/evis-cli/",
    "crates/evis-core/src/sensor/preset.rs",
    "python/evis/__main__.py",
    "python/evis/_commands.py",
)


def test_messages_of_libraries_name_settings_and_no_options() -> None:
    files = [*ROOT.glob("crates/*/src/**/*.rs"), *ROOT.glob("python/evis/*.py")]
    checked = 0
    for file in files:
        name = file.relative_to(ROOT).as_posix()
        if name.startswith(COMMAND_LINES) or "/tests" in name:
            continue
        assert options_in_messages(file.read_text("utf-8")) == [], f"{name}: Rust and Python have settings"
        checked += 1
    assert checked > 200
    planted = 'f("allow it (--force), or `info --repair`"); // "--why"'
    assert options_in_messages(planted) == ["--force"], "canary"


def wrong_options(text: str) -> list[str]:
    return sorted(set(re.findall(OPTION, text)) - known_options())


# Rust paths.


def crate_source(name: str) -> str | None:
    folder = f"crates/{name.replace('_', '-')}/src/"
    return folder if f"{folder}lib.rs" in files() else None


def has_word(word: str, texts: list[str]) -> bool:
    return any(re.search(rf"\b{word}\b", without_comments(text)) for text in texts)


def wrong_rust_path(path: str, own: str | None = None) -> bool:
    """Whether ``evis_x::y::z`` or, in the crate whose sources lie in `own`, ``crate::y::z`` leads nowhere."""
    root, *parts = path.split("::")
    folder = own if root == "crate" else crate_source(root)
    if folder is None:
        return True
    at, file = folder, f"{folder}lib.rs"
    for index, part in enumerate(parts):
        if f"{at}{part}.rs" in files():
            at, file = f"{at}{part}/", f"{at}{part}.rs"
        elif f"{at}{part}/mod.rs" in files():
            at, file = f"{at}{part}/", f"{at}{part}/mod.rs"
        else:
            # An item of that module, or of one that it exports whole; its own items follow.
            exports = re.search(r"pub use [\w:]+::\*", read(file))
            texts = [read(file)] if not exports else [read(f) for f in named(".rs", folder)]
            rest = parts[index + 1 :]
            return not has_word(part, texts) or not all(word in code_words() for word in rest)
    return False


def wrong_rust_paths(text: str, own: str | None = None) -> list[str]:
    roots = r"evis_[a-z]+|crate" if own else r"evis_[a-z]+"
    paths = re.findall(rf"(?<![\w:$])(?:{roots})(?:::{IDENTIFIER})+", text)
    return sorted({path for path in paths if wrong_rust_path(path, own)})


# Symbols.


def wrong_symbols(text: str) -> list[str]:
    """Types, functions and constants in code spans that no code of the repository has."""
    shape = rf"{IDENTIFIER}(?:::{IDENTIFIER})*(?:\(\))?"
    names = [span for span in re.findall(r"`([^`\n]+)`", text) if re.fullmatch(shape, span)]
    named_by_form = [n for n in names if "_" in n or "::" in n or re.match(r"[A-Z][a-z]", n)]
    crates = {Path(file).parts[1].replace("-", "_") for file in named("Cargo.toml", "crates/")}
    others = crates.union(*OTHER_SYMBOLS.values())
    # A transform is called by its spaces, whether or not a variable is.
    wanted = {n for n in named_by_form if not re.fullmatch(r"[a-z]+_from_[a-z]+", n)}
    return sorted(n for n in wanted if set(re.findall(IDENTIFIER, n)) - others - code_words())


def wrong_twins(text: str) -> list[str]:
    """``path.rs, name`` after "Twin:" where the file has no such name."""
    found = re.findall(rf"Twin: `?([\w./]+\.(?:rs|wgsl))`?, `?({IDENTIFIER})", text)
    return sorted(
        f"{path}, {name}" for path, name in found if not has_word(name, [read(f) for f in named(f"/{path}")])
    )


# The repository.


def test_something_is_read() -> None:
    assert {"README.md", "ARCHITECTURE.md", "docs/methods.md"} <= set(documents())
    assert "docs/notes/decoupled.md" in files()
    assert len(sources()) > 300
    assert len(known_options()) > 80
    assert "submission" in comments("crates/evis-render/src/engine/submission.rs")


@pytest.mark.parametrize("page", documents())
def test_documents_name_what_exists(page: str) -> None:
    text = read(page)
    assert wrong_paths(quoted(text)) == []
    assert wrong_options(text) == []
    assert wrong_rust_paths(text) == []


@pytest.mark.parametrize("page", [*documents(), *named(".md", "docs/notes/")])
def test_links_lead_to_headings(page: str) -> None:
    assert wrong_links(read(page), page) == []


@pytest.mark.parametrize("page", ["ARCHITECTURE.md", "CONTRIBUTING.md"])
def test_symbols_of_the_documents_exist(page: str) -> None:
    assert wrong_symbols(read(page)) == []


def test_comments_name_what_exists() -> None:
    wrong = {}
    for file in sources():
        text = comments(file)
        own = re.match(r"crates/[\w-]+/src/", file)
        found = wrong_paths(text) + wrong_rust_paths(text, own[0] if own else None)
        found += wrong_symbols(text) + wrong_twins(text)
        if found:
            wrong[file] = found
    assert wrong == {}


def test_messages_name_options_that_exist() -> None:
    texts = [f for f in sources() if f.startswith(("crates/", "python/")) and "/tests/" not in f]
    wrong = {file: found for file in texts if (found := wrong_options(read(file)))}
    assert wrong == {}


# Canaries.


def test_wrong_paths_are_found() -> None:
    assert (
        wrong_paths("see `crates/evis-core/src/event.rs` and src/gpu/mod.rs, shaders/trigger/count.wgsl")
        == []
    )
    assert wrong_paths("twin: cpu/trigger.rs; layout.rs; `crates/*/tests/`; tests/") == []
    assert wrong_paths("shaders/trigger/{count,emit}.wgsl") == []
    assert wrong_paths("`src/cpu/no_such.rs`") == ["src/cpu/no_such.rs"]
    assert wrong_paths("twin: cpu/no_such.rs.") == ["cpu/no_such.rs"]
    assert wrong_paths("`shaders/trigger/{count,no_such}.wgsl`") == ["shaders/trigger/no_such.wgsl"]
    assert wrong_paths("(docs/no_such.md), crates/evis-no/such, no_such_test.py") == [
        "crates/evis-no/such",
        "docs/no_such.md",
        "no_such_test.py",
    ]
    # A user's own files are not ours.
    assert wrong_paths("`out/events.h5` and my_scene.glb, https://example.org/src/main.rs") == []


def test_markdown_is_taken_apart() -> None:
    text = "A `span`, a [link](docs/x.md#there), prose.rs\n```sh\nrun tests/y.py\n```\n"
    assert set(quoted(text).split()) == {"span", "docs/x.md", "run", "tests/y.py"}


def test_wrong_links_are_found() -> None:
    text = "# A `b`: c, d\n[x](#a-b-c-d) [y](docs/methods.md#adaptive-time) [z](https://example.org#q)"
    assert wrong_links(text, "README.md") == []
    assert wrong_links("[x](#none)", "README.md") == ["#none"]
    assert wrong_links("[y](../methods.md#none) [z](methods.md)", "docs/notes/decoupled.md") == [
        "../methods.md#none",
        "methods.md",
    ]


def test_comments_are_taken_apart(tmp_path: Path) -> None:
    source = tmp_path / "source.rs"
    source.write_text("//! one\n/// two\nlet a = 1; // three\n", "utf-8")
    assert comments(str(source)).split() == ["one", "two", "three"]
    script = tmp_path / "script.py"
    script.write_text('"""one"""\nx = "code"  # two\n', "utf-8")
    assert comments(str(script)).split() == ["one", "two"]


def test_wrong_options_are_found() -> None:
    assert (
        wrong_options("`evis-rs run --quality high`, `cargo test --release`, --no-floor and a -- b --- c")
        == []
    )
    assert wrong_options("`--no-such-option`, --curved: x") == ["--curved", "--no-such-option"]


def test_options_of_clap_are_read() -> None:
    text = """
    #[arg(long, value_name = "[CAMERA=]PRESET")]
    pub(crate) sensor_model: Option<String>,
    #[arg(short, long = "to")]
    target: PathBuf,
    #[arg(value_name = "SCENE")]
    scene: String,
    /// Text.
    #[arg(
        long,
        value_parser = ["x", "y"]
    )]
    pub flip: bool,
    """
    assert declared(text) == {"--sensor-model", "--to", "--flip"}


def test_wrong_rust_paths_are_found() -> None:
    right = (
        "evis_core::trigger::decide, evis_core::emulator::EventEmulator::push, evis_scene::Scene::evaluate"
    )
    assert wrong_rust_paths(right) == []
    assert wrong_rust_paths("evis_core::no_such::Thing") == ["evis_core::no_such::Thing"]
    assert wrong_rust_paths("evis_none::trigger") == ["evis_none::trigger"]
    assert wrong_rust_paths("[`evis_core::trigger::no_such`]") == ["evis_core::trigger::no_such"]
    own = "crates/evis-render/src/"
    assert wrong_rust_paths("[`crate::sampling::view_motion`]", own) == []
    assert wrong_rust_paths("[`crate::view_motion`]", own) == ["crate::view_motion"]


def test_wrong_symbols_are_found() -> None:
    assert (
        wrong_symbols("`Simulator`, `Engine::recover`, `log_luminance_of`, `make test`, `evis_core`, `x`")
        == []
    )
    assert wrong_symbols("`NoSuchType` and `Engine::no_such`") == ["Engine::no_such", "NoSuchType"]
    assert wrong_twins("Twin: cpu/trigger.rs, no_such.") == ["cpu/trigger.rs, no_such"]
    assert wrong_twins("Twin: `cpu/splat.rs`, place.") == []
