"""Check that a wheel loads on old Linux systems: its tag, and the symbol versions that its library asks for.

Usage: tools/portable.py WHEEL
"""

from __future__ import annotations

import io
import re
import sys
import zipfile
from pathlib import Path

#: RHEL 8, and everything newer.
LIMIT = (2, 28)

#: Libraries that a manylinux wheel may expect of the system and that ours may need.
ALLOWED = re.compile(r"(libc|libm|libdl|libpthread|librt|libgcc_s|ld-linux-[a-z0-9_-]+)\.so\.\d+")


def newest(versions: list[str]) -> tuple[int, ...]:
    """Return the newest version of glibc among symbol versions such as ``GLIBC_2.17``."""
    found = [tuple(map(int, text[6:].split("."))) for text in versions if re.fullmatch(r"GLIBC_[\d.]+", text)]
    return max(found, default=(0,))


def problems(name: str, versions: list[str], libraries: list[str]) -> list[str]:
    """Say what keeps a wheel of this name and with these needs from systems with glibc 2.28."""
    found = []
    if "-abi3-manylinux_2_28_" not in name:
        found.append(f"{name} is not tagged abi3 and manylinux_2_28")
    if (needs := newest(versions)) > LIMIT:
        found.append(f"it asks for glibc {'.'.join(map(str, needs))}, beyond 2.28")
    foreign = [library for library in libraries if not ALLOWED.fullmatch(library)]
    if foreign:
        found.append(f"it needs {', '.join(foreign)}, which a manylinux wheel may not")
    return found


def needs(library: bytes) -> tuple[list[str], list[str]]:
    """Return the symbol versions and the libraries that a shared library asks for."""
    from elftools.elf.dynamic import DynamicSection
    from elftools.elf.elffile import ELFFile
    from elftools.elf.gnuversions import GNUVerNeedSection

    versions: list[str] = []
    libraries: list[str] = []
    for section in ELFFile(io.BytesIO(library)).iter_sections():
        if isinstance(section, GNUVerNeedSection):
            versions += [entry.name for _, entries in section.iter_versions() for entry in entries]
        if isinstance(section, DynamicSection):
            libraries += [tag.needed for tag in section.iter_tags("DT_NEEDED")]
    return versions, libraries


def main() -> int:
    """Check the wheel."""
    wheel = Path(sys.argv[1])
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".abi3.so")]
        versions, libraries = needs(archive.read(name))
    found = problems(wheel.name, versions, libraries)
    if not versions:
        found.append("its library names no symbol version; nothing was checked")
    for text in found:
        print(f"portable: {text}", file=sys.stderr)
    if not found:
        shown = ".".join(map(str, newest(versions)))
        print(f"portable: {wheel.name} asks for glibc {shown} and {', '.join(libraries)}")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
