"""The Debian packages that the virtual machine is made of: fetched once, unpacked into a cache, never installed.

Lists of packages lie in the cache too, so that neither root nor an up-to-date /var/lib/apt is needed, and nothing of the host
changes. What is made from them (kernel, initramfs, an emulator that runs) appears in the cache under its final name only when it
is whole; several runs may start side by side.
"""

import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import initramfs

#: What is fetched, beside the kernel: the emulator, a camera's own tool, a shell with everything a guest needs.
PACKAGES = ["qemu-system-x86", "v4l-utils", "busybox-static"]
#: The kernel: Debian's own, because the one for clouds has no camera drivers.
KERNEL = "linux-image-amd64"
#: Raised when the layout of the cache changes.
LAYOUT = 1


class VmError(Exception):
    """The machine cannot be made or did not do its work; says what to do about it."""


@dataclass
class Machine:
    """What the cache holds."""

    folder: Path

    @property
    def root(self):
        """The unpacked packages."""
        return self.folder / "root"

    @property
    def kernel(self):
        return self.folder / "vmlinuz"

    @property
    def initramfs(self):
        return self.folder / "base.cpio"

    def environment(self):
        """Environment in which programs of the packages find their libraries."""
        libraries = library_folders(self.root)
        modules = self.root / "usr/lib/x86_64-linux-gnu/qemu"
        return {**os.environ, "LD_LIBRARY_PATH": ":".join(libraries), "QEMU_MODULE_DIR": str(modules)}


def cache_folder():
    """Where everything that was fetched stays."""
    named = os.environ.get("VSERVO_VM_CACHE")
    return Path(named) if named else Path.home() / ".cache/vservo-vm"


def library_folders(root):
    """Folders of shared libraries below an unpacked root."""
    below = ["usr/lib/x86_64-linux-gnu", "lib/x86_64-linux-gnu", "usr/lib/x86_64-linux-gnu/pulseaudio"]
    return [str(root / b) for b in below]


def provide(tell):
    """The machine from the cache; fetched first where it is not there yet. `tell` takes a line of progress."""
    cache = cache_folder()
    name = hashlib.sha256(json.dumps([LAYOUT, PACKAGES, KERNEL, initramfs.MODULES]).encode()).hexdigest()[:12]
    machine = Machine(cache / name)
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with open(cache / "lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not machine.folder.is_dir():
                tell(f"fetching {', '.join(PACKAGES)} and {KERNEL} into {cache} (once, about 90 MB)")
                make(machine, cache)
    except OSError as cause:
        raise VmError(
            f"{cache}: {cause.strerror} ({cause.filename}); make room there, or set VSERVO_VM_CACHE to a folder that can be written"
        ) from cause
    return machine


def make(machine, cache):
    """Fetches and unpacks everything beside its final place, and moves it there."""
    require_tools()
    with tempfile.TemporaryDirectory(dir=cache, prefix="making-") as folder:
        building = Machine(Path(folder) / "machine")
        building.root.mkdir(parents=True)
        debs = Path(folder) / "debs"
        apt = Apt(Path(folder) / "apt")
        apt.update()
        kernel = apt.newest_kernel()
        versions = apt.download([*apt.missing(PACKAGES), kernel], debs)
        for deb in sorted(debs.glob("*.deb")):
            done = run(["dpkg-deb", "-x", str(deb), str(building.root)])
            if done.returncode:
                raise VmError(f"{deb.name} cannot be unpacked: {done.stderr.strip()}")
        release = kernel.split("=")[0].removeprefix("linux-image-")
        initramfs.build_base(building, release)
        shutil.copy(building.root / f"boot/vmlinuz-{release}", building.kernel)
        # What only the guest needed is in its initramfs now.
        for unused in ["lib/modules", "usr/lib/modules", "boot", "usr/share/doc", "usr/share/man", "usr/share/locale"]:
            shutil.rmtree(building.root / unused, ignore_errors=True)
        (building.folder / "packages.txt").write_text("\n".join(versions) + "\n")
        building.folder.rename(machine.folder)


def require_tools():
    """Programs of the host that fetching takes."""
    for program in ["apt-get", "apt-cache", "dpkg-deb", "ldd"]:
        if not shutil.which(program):
            raise VmError(
                f"{program} is not here: the machine is made of Debian's packages; run this on Debian 12 or newer (or in a "
                f"container of it), or copy {cache_folder()} from such a machine"
            )


def run(command, **options):
    return subprocess.run(command, text=True, capture_output=True, **options)


class Apt:
    """apt with lists of its own: the host's sources, nothing of its state but what is installed."""

    def __init__(self, folder):
        for place in ["lists/partial", "cache/archives/partial"]:
            (folder / place).mkdir(parents=True)
        options = {
            "Debug::NoLocking": "1",
            "APT::Install-Recommends": "false",
            "APT::Sandbox::User": "root",
            "Acquire::Retries": "2",
            "Acquire::http::Timeout": "30",
            "Dir::State::lists": f"{folder}/lists",
            "Dir::Cache": f"{folder}/cache",
        }
        self.options = [word for key, value in options.items() for word in ("-o", f"{key}={value}")]

    def call(self, program, *arguments, **options):
        environment = {**os.environ, "LC_ALL": "C.UTF-8", "DEBIAN_FRONTEND": "noninteractive"}
        return run([program, *self.options, *arguments], env=environment, **options)

    def update(self):
        done = self.call("apt-get", "update", "--error-on=any")
        if done.returncode:
            raise VmError(
                f"the package lists cannot be fetched:\n{complaints(done)}\nConnect the machine to the network (or set apt's "
                f"proxy), or copy {cache_folder()} from a machine that has it"
            )

    def newest_kernel(self):
        """The package that today's kernel meta package depends on, with its version."""
        done = self.call("apt-cache", "depends", "--important", KERNEL)
        found = re.search(r"Depends: (linux-image-\S+)", done.stdout)
        if not found:
            raise VmError(f"no package {KERNEL} in apt's sources: add a Debian 12 or newer source to /etc/apt")
        return found[1]

    def missing(self, packages):
        """`packages` and what they need beside what is installed here, as name=version."""
        for state in ([], ["-o", "Dir::State::status=/dev/null"]):
            # The second is for a host whose own packages are out of date or held: everything, down to the C library.
            done = self.call("apt-get", *state, "--simulate", "install", *packages)
            if done.returncode == 0:
                new = re.findall(r"^Inst (\S+) \((\S+) ", done.stdout, re.M)
                names = {name for name, _ in new}
                return [f"{name}={version}" for name, version in new] + [p for p in packages if p not in names]
        raise VmError(f"apt cannot find {', '.join(packages)}:\n{complaints(done)}\nAdd a Debian source with `main` to /etc/apt")

    def download(self, packages, folder):
        """Fetches packages; their names with versions."""
        folder.mkdir()
        done = self.call("apt-get", "download", *packages, cwd=folder)
        if done.returncode:
            raise VmError(f"packages cannot be fetched:\n{complaints(done)}\nTry again; what is missing then is the network's")
        return sorted(deb.stem for deb in folder.glob("*.deb"))


def complaints(done):
    """The lines of a program's output that say what is wrong."""
    lines = [line for line in done.stderr.splitlines() if line.startswith(("E:", "W:"))]
    return "\n".join(lines[:6]) or done.stderr.strip()[-600:] or "(it says nothing)"
