"""What the native libraries in build/platforms/ export and need, read from the files: python
tools/check_libraries.py [PLATFORM...].

Prints a line per library and what is wrong with it; the exit status is 0 if nothing is. Needs lief
(requirements-package.txt).
"""

from __future__ import annotations

import hashlib
import re
import struct
import sys
from pathlib import Path

import lief

from platforms import BUILT, LIBRARIES, ROOT, TABLE

HEADER = ROOT / "native/include/svrgs.h"
GLIBC = (2, 28)
ELF_NEEDS = r"(libc|libm|libpthread|libdl|librt)\.so\.\d|ld-linux[-\w]*\.so\.\d"
WINDOWS_NEEDS = r"(KERNEL32|ntdll|api-ms-win-[-\w]+)\.dll"
MACOS_NEEDS = ["/usr/lib/libSystem.B.dylib"]
MACOS_VERSION = [11, 0, 0]
# zig's linker for macOS has no way to hide these: operator new and delete, which are weak, and marks of the
# linker itself.
MACOS_MAY_EXPORT = r"__Z(nw|na|dl|da)\w+|__mh_dylib_header|___dso_handle"


def declared() -> set[str]:
    """The functions of svrgs.h."""
    return set(re.findall(r"^SVRGS_API .*?\b(svrgs_\w+)\(", HEADER.read_text(encoding="utf-8"), re.MULTILINE))


def wrong_exports(names: set[str]) -> list[str]:
    more, fewer = sorted(names - declared()), sorted(declared() - names)
    return [f"exports {', '.join(more)}"] * bool(more) + [f"does not export {', '.join(fewer)}"] * bool(fewer)


def wrong_elf(library: lief.ELF.Binary) -> list[str]:
    found = wrong_exports({symbol.name for symbol in library.exported_symbols})
    found += [f"needs {name}" for name in library.libraries if not re.fullmatch(ELF_NEEDS, name)]
    versions = {
        aux.name for needed in library.symbols_version_requirement for aux in needed.get_auxiliary_symbols()
    }
    for name in sorted(versions):
        version = re.fullmatch(r"GLIBC_([\d.]+)", name)
        if not version or tuple(map(int, version[1].split("."))) > GLIBC:
            found.append(f"needs {name}")
    return found


def wrong_pe(library: lief.PE.Binary) -> list[str]:
    export = library.get_export()
    found = wrong_exports({entry.name for entry in export.entries} if export else set())
    return found + [
        f"needs {entry.name}"
        for entry in library.imports
        if not re.fullmatch(WINDOWS_NEEDS, entry.name, re.IGNORECASE)
    ]


def wrong_signature(signature: bytes, path: Path) -> list[str]:
    """Of an ad hoc signature: a directory with a SHA-256 for each page of the file, up to the signature."""
    start = signature.find(bytes.fromhex("fade0c02"))
    if start < 0:
        return ["has a signature of another kind"]
    directory = signature[start:]
    flags, hashes, _, _, pages, limit, size, kind, _, bits = struct.unpack_from(">3I3I4B", directory, 12)
    signed = path.read_bytes()[:limit]
    found = [hashlib.sha256(signed[k << bits : k + 1 << bits]).digest() for k in range(pages)]
    stored = [directory[hashes + k * size :][:size] for k in range(pages)]
    return ["is not signed ad hoc"] * (not flags & 2 or kind != 2) + [
        "has been changed since it was signed"
    ] * (found != stored)


def wrong_macho(library: lief.MachO.Binary, path: Path) -> list[str]:
    names = {symbol.name for symbol in library.exported_symbols}
    found = wrong_exports({name[1:] for name in names if not re.fullmatch(MACOS_MAY_EXPORT, name)})
    identity = lief.MachO.LoadCommand.TYPE.ID_DYLIB
    needs = [command.name for command in library.libraries if command.command != identity]
    if needs != MACOS_NEEDS:
        found.append(f"needs {', '.join(needs)}")
    if not library.has_build_version or library.build_version.minos != MACOS_VERSION:
        found.append("is not for macOS 11.0")
    if library.has_code_signature:
        return found + wrong_signature(bytes(library.code_signature.content), path)
    # Macs on Intel load what is not signed
    needed = library.header.cpu_type == lief.MachO.Header.CPU_TYPE.ARM64
    return found + ["is not signed"] * needed


def wrong(path: Path) -> list[str]:
    """Sentences without their subject, the library."""
    library = lief.parse(path)
    if isinstance(library, lief.ELF.Binary):
        return wrong_elf(library)
    if isinstance(library, lief.PE.Binary):
        return wrong_pe(library)
    if isinstance(library, lief.MachO.Binary):
        return wrong_macho(library, path)
    return ["is no library"]


def main() -> int:
    lief.logging.disable()
    failed = False
    for platform in sys.argv[1:] or TABLE["platform"]:
        path = BUILT / TABLE["platform"][platform]["target"] / LIBRARIES[platform.partition("-")[0]]
        complaints = wrong(path) if path.exists() else ["is missing"]
        print(f"{path.relative_to(ROOT)}: {'; '.join(complaints) or 'right'}")
        failed |= bool(complaints)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
