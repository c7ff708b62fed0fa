"""The docs site: the code of its pages runs, it builds without a warning, and it fetches nothing."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest
from test_readme import blocks, run_code

import evis
from evis.dataset import read_spec

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"

#: Pages whose Python runs, and what they need beside NumPy. ``py`` marks code of other programs.
PAGES = {
    "tutorials/scene-to-network": ["torch"],
    "tutorials/own-video": [],
    "tutorials/own-renderer": [],
    "migrate/v2e": [],
    "migrate/esim": [],
    "migrate/isaac-plugin": ["h5py"],
    "migrate/metavision": [],
    "dataset": [],
}


def test_every_new_page_with_code_is_run() -> None:
    folders = [DOCS / "tutorials", DOCS / "migrate", DOCS / "api"]
    pages = [page for folder in folders for page in folder.glob("*.md")]
    pages += [DOCS / f"{name}.md" for name in ("index", "concepts", "model", "dataset", "real-recording")]
    with_code = {
        page.relative_to(DOCS).with_suffix("").as_posix() for page in pages if blocks(page, "python")
    }
    assert with_code == set(PAGES)


@pytest.mark.parametrize("name", list(PAGES))
def test_code_of_a_page_runs(name: str, device: evis.Device, tmp_path: Path) -> None:
    for package in PAGES[name]:
        pytest.importorskip(package, reason=f"{name}.md needs {package}")
    code = "\n".join(blocks(DOCS / f"{name}.md", "python"))
    assert code.count("\n") > 5
    done = run_code(code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip(), "it prints what it made"
    if name == "tutorials/scene-to-network":
        error, mean = map(
            float, re.findall(r"test error ([\d.]+), of the mean speed ([\d.]+)", done.stdout)[0]
        )
        assert error < mean, "the page says that the network beats the mean"


def test_code_that_is_out_of_date_does_not_pass(tmp_path: Path) -> None:
    """Canary of the code of pages."""
    code = "\n".join(blocks(DOCS / "tutorials/own-video.md", "python"))
    assert run_code(code.replace("evis.video(", "evis.movie("), tmp_path).returncode != 0


def test_specifications_of_the_page_are_read(tmp_path: Path) -> None:
    (text,) = blocks(DOCS / "dataset.md", "toml")
    (tmp_path / "models").mkdir()
    (tmp_path / "pictures").mkdir()
    (tmp_path / "models" / "fox.glb").write_bytes(b"glTF")
    (tmp_path / "pictures" / "a.png").write_bytes(b"")
    (tmp_path / "sensor.toml").write_text("threshold_on = 0.3\n", "utf-8")
    with pytest.raises(evis.EvisError, match=r"line \d+: .*a.png"):
        read_spec(_written(tmp_path, text))
    (tmp_path / "spec.toml").write_text(text.replace('images = "pictures", ', ""), "utf-8")
    spec = read_spec(tmp_path / "spec.toml")
    assert len(spec.recordings()) == 4 * 2 * (1 + 1 + 50)
    # Every key of the tables is a key that is known, and the other way round.
    from evis import _dataset_spec as known

    page = (DOCS / "dataset.md").read_text("utf-8")
    for keys in (known._TOP, known._SCENE, known._TRAJECTORY, known._SENSOR, known.SIMULATOR_KEYS):
        assert [key for key in keys if f"`{key}`" not in page and f"[{key}]" not in page] == []


def _written(folder: Path, text: str) -> Path:
    (folder / "spec.toml").write_text(text, "utf-8")
    return folder / "spec.toml"


def sensor_keys(text: str) -> dict[str, dict[str, object]]:
    """Keys and defaults of each stage, as a page has them; thresholds have no stage."""
    found: dict[str, dict[str, object]] = {}
    for title, part in re.findall(r"(?ms)^## `?\[?(\w+)\]?`?$(.*?)(?=^## |\Z)", text):
        for key, default in re.findall(r"(?m)^\| `(\w+)` \| `?([^`|]+?)`? \| ", part):
            found.setdefault(title, {})[key] = json.loads(default)
    return found


def test_the_page_of_sensor_keys_has_every_key_with_its_default() -> None:
    page = sensor_keys((DOCS / "sensor-keys.md").read_text("utf-8"))
    sensor = evis.Sensor()
    plain = {field.name: getattr(sensor, field.name) for field in fields(sensor)}
    stages = {name: value for name, value in plain.items() if is_dataclass(value)}
    del plain["diffusion"]
    assert page.pop("Thresholds") == {name: value for name, value in plain.items() if name not in stages}
    assert page == {
        name: {f.name: getattr(stage, f.name) for f in fields(stage)} for name, stage in stages.items()
    }
    assert sum(map(len, page.values())) == 49
    # Canary.
    assert sensor_keys("## `[noise]`\n| `leak_hz` | 0.1 | Hz | x |\n") == {"noise": {"leak_hz": 0.1}}


def test_the_sensor_of_the_page_is_read() -> None:
    (text,) = blocks(DOCS / "sensor-keys.md", "toml")
    assert evis.Sensor.from_toml(text).noise.leak_hz == 0.1


# The site.


def requirements(text: str) -> set[str]:
    return set(re.findall(r'"([^"]+)"', text))


def test_what_builds_the_site_is_named_once_more_in_the_makefile() -> None:
    makefile = re.findall(r"(?m)^SITE_PACKAGES := (.*)$", (ROOT / "Makefile").read_text("utf-8"))[0]
    extra = re.findall(r"(?m)^docs = \[(.*)\]$", (ROOT / "pyproject.toml").read_text("utf-8"))[0]
    assert requirements(makefile) == requirements(extra)
    assert len(requirements(extra)) == 3
    assert requirements(makefile.replace("10", "9")) != requirements(extra)  # canary


def fetched(text: str) -> list[str]:
    """Scripts, styles, fonts and pictures that a page or a style sheet takes from elsewhere."""
    found = re.findall(r'<(?:script|img|iframe|source)[^>]*\ssrc="((?:https?:)?//[^"]*)"', text)
    for tag in re.findall(r"<link[^>]*>", text):
        if re.search(r'rel="(?:stylesheet|preload|preconnect|icon|modulepreload)"', tag):
            found += re.findall(r'href="((?:https?:)?//[^"]*)"', tag)
    return (
        found
        + re.findall(r"url\([\"']?((?:https?:)?//[^)\"']*)", text)
        + re.findall(r"@import\s+[\"']((?:https?:)?//[^\"']*)", text)
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for package in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed: make site")
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


def test_the_site_fetches_nothing(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    for file in [*pages, *site.rglob("*.css")]:
        assert fetched(file.read_text("utf-8")) == [], file.name
    # Canary: what a site with fonts and formulas from elsewhere has.
    assert fetched(
        '<script src="https://x.org/a.js"></script><link rel="stylesheet" href="//x.org/b.css">'
    ) == [
        "https://x.org/a.js",
        "//x.org/b.css",
    ]
    assert fetched("src: url(https://x.org/font.woff2)") == ["https://x.org/font.woff2"]


def test_every_page_is_in_the_site(site: Path) -> None:
    for page in DOCS.rglob("*.md"):
        assert (site / page.relative_to(DOCS).with_suffix(".html")).exists(), page
    for name in ("project", "ARCHITECTURE", "CONTRIBUTING", "SECURITY", "CHANGELOG"):
        assert (site / f"{name}.html").exists()
    home = (site / "index.html").read_text("utf-8")
    assert "tutorials/scene-to-network.html" in home


def test_the_search_runs_where_pages_are_opened_as_files(site: Path) -> None:
    """The index is a script, and what stands in for a worker comes before the theme's own script."""
    held = json.loads((site / "search" / "search_index.json").read_text("utf-8"))
    assert len(held["docs"]) > 500
    script = (site / "search" / "search_index.js").read_text("utf-8")
    assert script.startswith("var __index = {")
    assert json.loads(script.removeprefix("var __index = ")) == held
    for page in ("index.html", "migrate/v2e.html"):
        scripts = re.findall(r'<script src="([^"]+)"', (site / page).read_text("utf-8"))
        assert [Path(name).name.split(".")[0] for name in scripts] == ["search-from-files", "bundle"]
        assert all(((site / page).parent / name).exists() for name in scripts)


def test_formulas_and_docstrings_are_there(site: Path) -> None:
    model = (site / "model.html").read_text("utf-8")
    assert model.count("<math") > 25
    assert "arithmatex" not in model
    assert "$$" not in re.sub(r"(?s)<code.*?</code>", "", model)
    reference = (site / "api" / "simulate.html").read_text("utf-8")
    for name in ("evis.Simulator.stream", "evis.SceneBuilder.box", "evis.motion.Keys"):
        assert f'id="{name}"' in reference, name
    assert 'id="evis.Simulator.fly"' not in reference  # canary
    assert "Rust documentation" in (site / "project.html").read_text("utf-8")


def test_names_of_the_package_are_in_the_reference(site: Path) -> None:
    text = "".join(page.read_text("utf-8") for page in (site / "api").glob("*.html"))
    # Results of checks, and dtypes, have no entry of their own; the rest that users call has.
    modules = {"evis": evis}
    modules |= {
        f"evis.{name}": getattr(evis, name)
        for name in ("emulation", "events", "files", "measure", "packets", "sensors")
    }
    functions = [
        f"{place}.{name}"
        for place, module in modules.items()
        for name in module.__all__
        if callable(getattr(module, name)) and name[0].islower()
    ]
    assert len(functions) > 20
    assert [name for name in functions if f'id="{name}"' not in text] == []
