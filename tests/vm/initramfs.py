"""The guest's file system: archives in the kernel's own format (cpio, "newc"), without further tools.

The base, made once: busybox, v4l2-ctl and the drivers with what they depend on. Everything of a run (programs, their libraries,
configuration) is a second archive behind it; the kernel unpacks both, and what comes later replaces what came before.
"""

import os
import re
import shutil
import stat
import subprocess
from pathlib import Path

#: Drivers in the guest; what they depend on comes along.
MODULES = ["virtio_pci", "9p", "9pnet_virtio", "vivid", "uvcvideo", "vhci-hcd"]
LOADER = "lib64/ld-linux-x86-64.so.2"
GUEST = Path(__file__).parent / "guest"


class Archive:
    """A cpio archive in memory."""

    def __init__(self):
        self.bytes = bytearray()
        self.names = set()

    def entry(self, name, mode, data=b"", device=(0, 0)):
        """One entry; a name counts once."""
        name = str(name).strip("/")
        if name in self.names:
            return
        self.names.add(name)
        encoded = name.encode() + b"\0"
        fields = [len(self.names), mode, 0, 0, 1, 0, len(data), 0, 0, *device, len(encoded), 0]
        self.bytes += b"070701" + b"".join(b"%08X" % value for value in fields) + encoded
        self.pad()
        self.bytes += data
        self.pad()

    def pad(self):
        self.bytes += bytes(-len(self.bytes) % 4)

    def folder(self, name):
        """A folder and those above it."""
        parts = str(name).strip("/").split("/")
        for length in range(1, len(parts) + 1):
            self.entry("/".join(parts[:length]), stat.S_IFDIR | 0o755)

    def file(self, name, data, mode=0o755):
        self.folder(Path(str(name).strip("/")).parent)
        self.entry(name, stat.S_IFREG | mode, data)

    def copy(self, source, name=None):
        """A file or folder of the host under its own path, or under `name`; links are followed."""
        source, name = Path(source), Path(name or source)
        if source.is_dir():
            self.folder(name)
            for inside in sorted(source.iterdir()):
                self.copy(inside, name / inside.name)
        elif source.is_file():
            self.file(name, source.read_bytes(), stat.S_IMODE(source.stat().st_mode))

    def link(self, name, to):
        self.entry(name, stat.S_IFLNK | 0o777, to.encode())

    def finished(self):
        """The whole archive."""
        self.entry("TRAILER!!!", 0)
        return bytes(self.bytes)


def libraries(program, environment=None):
    """Shared libraries that a program of the host is linked to; none for a static one or a script."""
    done = subprocess.run(["ldd", str(program)], text=True, capture_output=True, env=environment)
    return sorted(set(re.findall(r"(/\S+) \(0x", done.stdout)))


def add_libraries(archive, program, environment=None):
    """The libraries of `program`, where the guest looks for them."""
    for library in libraries(program, environment):
        name = LOADER if "/ld-linux" in library else f"lib/{os.path.basename(library)}"
        archive.file(name, Path(os.path.realpath(library)).read_bytes())


def build_base(machine, release):
    """What every run has in common."""
    root = machine.root
    archive = Archive()
    for name in ["proc", "sys", "dev", "mnt", "tmp", "root", "bin", "lib/modules"]:
        archive.folder(name)
    archive.entry("dev/console", stat.S_IFCHR | 0o600, device=(5, 1))
    archive.file("bin/busybox", program_of(root, "busybox").read_bytes())
    archive.link("bin/sh", "busybox")
    control = program_of(root, "v4l2-ctl")
    archive.file("bin/v4l2-ctl", control.read_bytes())
    add_libraries(archive, control, machine.environment())
    add_modules(archive, root, release)
    machine.initramfs.write_bytes(archive.finished())


def program_of(root, name):
    """A program of the unpacked packages."""
    found = shutil.which(name, path=f"{root}/bin:{root}/usr/bin:{root}/usr/sbin")
    if not found:
        raise FileNotFoundError(2, f"the packages hold no {name}", str(root))
    return Path(found)


def add_modules(archive, root, release):
    """Every driver with a file that names, in the order in which they are loaded, what it depends on and itself."""
    found = {}
    for path in (root / "lib/modules" / release).rglob("*.ko"):
        found[path.stem.replace("-", "_")] = path.read_bytes()

    def visit(name, order):
        name = name.replace("-", "_")
        if name in found and name not in order:  # those that are not there are built in
            needed = re.search(rb"\0depends=([^\0]*)\0", found[name])
            for dependency in filter(None, needed[1].decode().split(",") if needed else []):
                visit(dependency, order)
            order.append(name)
        return order

    for module in MODULES:
        order = visit(module, [])
        if not order:
            raise FileNotFoundError(2, f"the kernel {release} has no driver {module}", str(root))
        for name in order:
            archive.file(f"lib/modules/{name}.ko", found[name], 0o644)
        archive.file(f"lib/modules/{order[-1]}.order", (" ".join(order) + "\n").encode(), 0o644)


def build_run(programs, files, script):
    """What one run adds: `programs` (path in the guest: file to put there) with their libraries, `files` (path in the guest:
    file or folder of the host), and the script that the guest is to run."""
    archive = Archive()
    archive.file("run.sh", script.encode())
    for name in ["init", "bin/mods"]:
        archive.file(name, (GUEST / Path(name).name).read_bytes())
    for name, source in programs.items():
        archive.copy(source, name)
        add_libraries(archive, source)
    for name, source in files.items():
        archive.copy(source, name)
    return archive.finished()
