"""What packages say of themselves: one version, a description that an index can show, old systems."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from test_readme import ROOT, blocks

import evis

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def versions() -> dict[str, str]:
    """Every place that names the version of EVIS."""
    cargo = tomllib.loads((ROOT / "Cargo.toml").read_text("utf-8"))["workspace"]
    found = {"workspace": cargo["package"]["version"]}
    found |= {
        name: table["version"] for name, table in cargo["dependencies"].items() if name.startswith("evis-")
    }
    lock = tomllib.loads((ROOT / "Cargo.lock").read_text("utf-8"))["package"]
    found |= {
        f"{package['name']} in Cargo.lock": package["version"]
        for package in lock
        if package["name"].startswith("evis-")
    }
    (cited,) = re.findall(r"(?m)^version: (.+)$", (ROOT / "CITATION.cff").read_text("utf-8"))
    return found | {"CITATION.cff": cited, "the package": evis.__version__}


def test_one_version_everywhere() -> None:
    found = versions()
    assert len(found) > 20
    assert len(set(found.values())) == 1, found
    released = re.findall(r"(?m)^## \[([^]]+)\]", (ROOT / "CHANGELOG.md").read_text("utf-8"))
    assert released[0] == "Unreleased"


def shown_by_an_index(text: str) -> bool:
    """Whether an index shows all of a page: it has neither the repository's files nor its pictures."""
    targets = re.findall(r"\]\(([^)]+)\)", text) + re.findall(r"(?:src|href)=[\"']([^\"']+)", text)
    return all(target.startswith("https://") for target in targets)


def test_the_description_of_the_package_survives_an_index() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    page = ROOT / project["readme"]
    assert shown_by_an_index(page.read_text("utf-8"))
    assert not shown_by_an_index((ROOT / "README.md").read_text("utf-8")), "canary: it has relative links"
    (code,) = blocks(page, "python")
    (of_readme, *_) = blocks(ROOT / "README.md", "python")
    assert code == of_readme, "README's code is run"
    assert project["authors"]
    assert set(re.findall(r"`(\w+)`", page.read_text("utf-8").split("Extras:")[1].split("\n")[0])) < set(
        project["optional-dependencies"]
    )


@pytest.fixture(scope="module")
def portable(tool: Callable[[str], ModuleType]) -> ModuleType:
    return tool("portable")


def test_wheels_for_old_systems_are_checked(portable: ModuleType) -> None:
    name = "evis-0.2.0-cp310-abi3-manylinux_2_28_x86_64.whl"
    old, new = ["GLIBC_2.2.5", "GLIBC_2.28", "GCC_3.0"], ["GLIBC_2.9", "GLIBC_2.34"]
    assert portable.newest(old) == (2, 28)
    assert portable.problems(name, old, ["libc.so.6", "ld-linux-x86-64.so.2"]) == []
    assert "glibc 2.34" in portable.problems(name, new, [])[0]
    assert "libvulkan.so.1" in portable.problems(name, old, ["libvulkan.so.1"])[0]
    assert "not tagged" in portable.problems(name.replace("2_28", "2_35"), old, [])[0]


def test_needs_of_the_installed_library_are_read(portable: ModuleType) -> None:
    pytest.importorskip("elftools", reason="reads ELF")
    library = Path(evis._evis.__file__)
    versions, libraries = portable.needs(library.read_bytes())
    assert "libc.so.6" in libraries
    assert portable.newest(versions) >= (2, 14)
