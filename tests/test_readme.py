"""What the documents show runs: their code, their options, their tasks, their links."""

from __future__ import annotations

import html
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

import evis

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = [ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md")]
DOCUMENTS += [page for page in sorted((ROOT / "docs").rglob("*.md")) if page.parent.name != "notes"]


def blocks(document: Path, language: str) -> list[str]:
    """The code of every fenced block of `language`, with or without a title."""
    return re.findall(
        rf"^```{language}(?: [^\n]*)?\n(.*?)^```$", document.read_text("utf-8"), re.DOTALL | re.MULTILINE
    )


def shell_lines(document: Path) -> list[list[str]]:
    return [shlex.split(line) for block in blocks(document, "sh") for line in block.splitlines() if line]


def python(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=120, check=False)


def run_code(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    script = folder / "snippet.py"
    script.write_text(code, "utf-8")
    return python(str(script), cwd=folder)


def test_python_of_the_readme_runs(device: evis.Device, tmp_path: Path) -> None:
    code = "\n".join(blocks(ROOT / "README.md", "python"))
    small, replaced = re.subn(r"size=\(320, 240\)", "size=(64, 48)", code)
    assert replaced == 1, "the README's size is what this test makes small"
    done = run_code(small, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("of them ON") == 5
    # Canary: code that is out of date does not pass.
    assert run_code(small.replace("duration=", "seconds="), tmp_path).returncode != 0


def test_the_readme_is_short_and_installs_by_no_registered_name() -> None:
    text = (ROOT / "README.md").read_text("utf-8")

    def installs_a_name(text: str) -> bool:
        return bool(re.search(r"(pip|cargo) install (?!(\S+ )*(\.|dist/|--path\b))", text))

    assert len(text.split()) < 900
    assert not installs_a_name(text)
    assert installs_a_name("pip install evis")  # canary


def test_rust_of_the_documents_is_the_example() -> None:
    example = (ROOT / "crates/evis-render/examples/stream.rs").read_text("utf-8")
    code = "".join(line for line in example.splitlines(keepends=True) if not line.startswith("//!"))
    (shown,) = blocks(ROOT / "docs/rust.md", "rust")
    assert shown.strip() == code.strip()
    assert shown.replace("100_000", "100_001").strip() != code.strip()  # canary


def test_h5py_code_runs(device: evis.Device, tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    run = "run spinner -o events.h5 --size 64x48 --duration 0.06 --samples 1 --labels depth"
    made = python("-m", "evis", *run.split(), cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    code = blocks(ROOT / "docs/hdf5.md", "python")
    of_h5py = [block for block in code if "import h5py" in block]
    assert (len(of_h5py), len(code)) == (2, 3)
    for block in of_h5py:
        done = run_code(block, tmp_path)
        assert done.returncode == 0, done.stderr
        assert int(done.stdout.split()[0]) > 0


@pytest.mark.parametrize("name", ["video", "calibration", "formats"])
def test_code_for_frames_and_recordings_runs(name: str, tmp_path: Path) -> None:
    found = blocks(ROOT / f"docs/{name}.md", "python")
    assert found
    for code in found:
        done = run_code(code, tmp_path)
        assert done.returncode == 0, done.stderr
        assert len(done.stdout.splitlines()) >= 2


def test_code_for_dense_arrays_runs(device: evis.Device, tmp_path: Path) -> None:
    found = blocks(ROOT / "docs/representations.md", "python")
    assert len(found) >= 10
    for code in found:
        done = run_code(code, tmp_path)
        assert done.returncode == 0, done.stderr
        assert len(done.stdout.splitlines()) >= 2, code
    # Canary: code that is out of date does not pass.
    assert run_code(found[-1].replace("bins=", "bin="), tmp_path).returncode != 0


def test_code_for_evaluation_runs(device: evis.Device, tmp_path: Path) -> None:
    code = blocks(ROOT / "docs/evaluate.md", "python")
    assert len(code) == 2
    done = [run_code(block, tmp_path) for block in code]
    assert [each.returncode for each in done] == [0, 0], done[0].stderr + done[1].stderr
    assert done[0].stdout.splitlines()[-1].startswith("True "), "the controls fail"
    with_events, without = (float(line.split()[-1]) for line in done[1].stdout.splitlines())
    assert with_events > 0.9 > without + 0.2


def options(command: str) -> set[str]:
    return set(re.findall(r"(?<!\S)--?[a-z][a-z0-9-]*", python("-m", "evis", command, "--help").stdout))


def test_options_of_the_documents_exist() -> None:
    checked = 0
    for document in DOCUMENTS:
        for words in shell_lines(document):
            if words[0] != "evis-rs" and words[:2] != ["evis", "dataset"]:
                continue
            known = options(words[1])
            # What stands behind -- is another program's.
            ours = words[2 : words.index("--")] if "--" in words else words[2:]
            used = {word for word in ours if word.startswith("-")}
            assert "--help" in known, words
            assert used <= known, f"{document.name}: {sorted(used - known)} of {words[1]}"
            checked += 1
    assert checked >= 10
    assert not {"--no-such-option"} <= options("run")  # canary


def test_tasks_of_the_documents_exist() -> None:
    tasks = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    texts = [document.read_text("utf-8") for document in DOCUMENTS]
    shown = {words[1] for document in DOCUMENTS for words in shell_lines(document) if words[0] == "make"}
    shown |= {task for text in texts for task in re.findall(r"`make ([a-z-]+)", text)}
    assert shown >= {"setup", "demo", "test", "check", "bench", "smoke"}
    assert shown <= tasks, shown - tasks
    assert "no-such-task" not in tasks  # canary


def broken_links(text: str, folder: Path) -> list[str]:
    targets = re.findall(r"\]\(([^)\s]+)\)", text)
    return [t for t in targets if "://" not in t and not (folder / t.split("#")[0]).exists()]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document: Path) -> None:
    text = document.read_text("utf-8")
    assert broken_links(text, document.parent) == []
    assert broken_links(text + "[x](no/such/file.md)", document.parent) == ["no/such/file.md"]  # canary


def test_the_chart_of_the_readme_shows_the_table_of_the_presets(
    tool: Callable[[str], ModuleType],
) -> None:
    chart = tool("presets_chart")
    page = chart.PAGE.read_text("utf-8")
    picture = html.unescape(chart.PICTURE.read_text("utf-8"))
    assert chart.drawn(page) in picture, "run tools/presets_chart.py"
    assert "docs/images/presets.svg" in (ROOT / "README.md").read_text("utf-8")
    # Canary: another number is another picture.
    other, count = re.subn(r"(\(decoupled, 2 px\) \| `spinner` \|) 0\.\d+", r"\1 0.123", page)
    assert count == 1
    assert chart.drawn(other) not in picture


def test_pictures_are_small() -> None:
    pictures = list((ROOT / "docs/images").glob("*.png"))
    assert pictures
    assert all(picture.stat().st_size < 300_000 for picture in pictures)
