"""What the documents show runs: their code, their options, their tasks, their links."""

from __future__ import annotations

import html
import importlib.util
import json
import os
import re
import shlex
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from test_video import find_ffmpeg

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
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300, check=False)


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


#: Commands of the README that are not run: it opens a window.
NOT_RUN = {"evis view events.h5"}


def board() -> bytes:
    """Return a file of glTF, binary: a board that moves for 0.1 s in front of a camera."""
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)
    order = np.array([0, 1, 2, 0, 2, 3], np.uint16)
    times, places = np.array([0, 0.1], np.float32), np.array([(0, 0, 0), (0.1, 0, 0)], np.float32)
    columns: list[tuple[np.ndarray, int, str]] = [
        (corners, 5126, "VEC3"),
        (order, 5123, "SCALAR"),
        (times, 5126, "SCALAR"),
        (places, 5126, "VEC3"),
    ]
    views, accessors, binary = [], [], b""
    for number, (values, kind, shape) in enumerate(columns):
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes})
        binary += values.tobytes() + bytes(-values.nbytes % 4)
        accessors.append({"bufferView": number, "componentType": kind, "count": len(values), "type": shape})
        if shape == "VEC3" or number == 2:
            bounds = [values.min(axis=0), values.max(axis=0)]
            accessors[-1]["min"], accessors[-1]["max"] = (np.ravel(bound).tolist() for bound in bounds)
    channel = {"sampler": 0, "target": {"node": 0, "path": "translation"}}
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"name": "board", "mesh": 0}, {"name": "camera", "camera": 0, "translation": [0, 0, 4]}],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.9, "znear": 0.1}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "animations": [{"samplers": [{"input": 2, "output": 3}], "channels": [channel]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    parts = (
        struct.pack("<II", len(text), 0x4E4F534A)
        + text
        + struct.pack("<II", len(binary), 0x004E4942)
        + binary
    )
    return struct.pack("<4sII", b"glTF", 2, len(parts) + 12) + parts


def stand_ins(folder: Path, ffmpeg: str) -> None:
    """Make small files of a user's, by the names that the README has for them."""
    for name in ("scene.glb", "model.glb"):
        (folder / name).write_bytes(board())
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    film = b"".join(((x * 5 + y * 3 + 9 * k) % 256).astype(np.uint8).tobytes() for k in range(6))
    encode = f"{ffmpeg} -v error -f rawvideo -pix_fmt gray -s 64x48 -r 30 -i pipe:0 in.mp4"
    subprocess.run(shlex.split(encode), cwd=folder, input=film, check=True)
    events = np.zeros(400, evis.EventCD)
    number = np.arange(len(events))
    events["t"], events["x"], events["y"], events["p"] = number * 25, number % 64, number % 48, number % 2
    evis.save(folder / "in.raw", evis.EventArray(events, width=64, height=48))
    spec = (
        'name = "small"\nduration_s = 0.02\n[simulator]\nsize = [32, 24]\n[[scenes]]\nbuiltin = "spinner"\n'
    )
    (folder / "SPEC.toml").write_text(spec, "utf-8")


def test_commands_of_the_readme_run_as_written(device: evis.Device, tmp_path: Path) -> None:
    ffmpeg = find_ffmpeg()
    if ffmpeg is None:
        pytest.skip("no ffmpeg: pip install imageio-ffmpeg, or apt-get install ffmpeg")
    networks = Path(os.environ.get("EVIS_ASSETS", "no-assets")) / "networks"
    stand_ins(tmp_path, ffmpeg)
    text = (ROOT / "README.md").read_text("utf-8")
    commands = [html.unescape(command) for command in re.findall(r"`(evis [^`]+)`", text)]
    # What stands alone is a name: its page has the command, and its options are there.
    names = {command for command in commands if len(command.split()) == 2}
    assert names == {"evis calibrate", "evis compare"}
    run = [command for command in commands if command not in names | NOT_RUN]
    assert len(run) == 8
    assert set(commands) >= NOT_RUN
    for command in run:
        words = shlex.split(command)[1:]
        if "firenet.onnx" in words:
            if not networks.is_dir() or importlib.util.find_spec("onnxruntime") is None:
                continue
            shutil.copy(networks / "firenet.onnx", tmp_path / "firenet.onnx")
        if words[0] == "video":
            # The recording of another line, under the same name.
            (tmp_path / "events.h5").unlink()
        done = python("-m", "evis", *words, cwd=tmp_path)
        assert done.returncode == 0, f"{command}: {done.stderr}"
    made = {"events.h5", "still.png", "events.mp4", "out.h5", "DIR"}
    assert made <= {path.name for path in tmp_path.iterdir()}
    assert len(evis.load(tmp_path / "out.h5").events) == 400
    # Canary: a command that is out of date does not pass.
    assert python("-m", "evis", "convert", "in.raw", "--to", "out2.h5", cwd=tmp_path).returncode == 2


def test_expressions_of_the_readme_run(device: evis.Device, tmp_path: Path) -> None:
    text = (ROOT / "README.md").read_text("utf-8")
    rows = [row for row in text.splitlines() if row.startswith("| ")]
    shown = re.findall(r"`((?:evis|packet)\.[^`]+\))`", "\n".join(rows))
    assert [code.split("(")[0] for code in shown] == ["evis.EventEmulator", "packet.voxel_grid"]
    lines = [
        "import evis, numpy as np",
        "frame, t_us = np.full((260, 346), 0.5, np.float32), 1000",
        "sim = evis.Simulator(evis.Scene.builtin('spinner'), size=(64, 48))",
        *re.findall(r'`(evis\.save\("events\.h5"[^`]+)`', text),
        "packet = sim.step(10_000)",
        *(f"print(type({code}).__name__)" for code in shown),
    ]
    assert len(lines) == 7
    done = run_code("\n".join(lines), tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.split()) == 2
    assert (tmp_path / "events.h5").is_file()


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


@cache
def options(*command: str) -> frozenset[str]:
    shown = python("-m", "evis", *command, "--help").stdout
    return frozenset(re.findall(r"(?<![\w-])--?[a-z][a-z0-9-]*", shown))


def test_options_of_the_documents_exist() -> None:
    checked = 0
    for document in DOCUMENTS:
        for words in shell_lines(document):
            assert words[0] != "evis-rs", f"{document.name}: say evis, as docs/packages.md does"
            if words[0] != "evis":
                continue
            # The tasks of evaluate have options of their own.
            known = options(*words[1 : 3 if words[1] == "evaluate" else 2])
            # What stands behind -- is another program's.
            ours = words[2 : words.index("--")] if "--" in words else words[2:]
            used = {word for word in ours if word.startswith("-")}
            assert known, f"{words} has no help"
            assert used <= known, f"{document.name}: {sorted(used - known)} of {words[1]}"
            checked += 1
    assert checked >= 40
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
