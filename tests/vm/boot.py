"""One boot of the machine: the emulator, its clock, and what comes back.

The guest's clock counts instructions (2**SHIFT ns each) and skips idle time: however busy the host is, the guest sees a
machine of the same speed, and no frame is lost for want of it. A guest that waits for the host would see its clock jump; that
is why everything it needs lies in its memory.
"""

import ctypes
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path

import initramfs
from packages import VmError

#: One instruction takes 2**SHIFT ns of the guest's time.
SHIFT = 0
MEMORY_MIB = 2048
#: Exit code of a run that took too long, as timeout(1) has it.
TIMED_OUT = 124
KERNEL_LINE = (
    "console=ttyS1 quiet loglevel=4 panic=-1 oops=panic rdinit=/init random.trust_cpu=on mitigations=off nokaslr "
    "tsc=reliable no_timer_check"
)


def boot(machine, programs, files, script, back, timeout_s, clock):
    """Runs `script` in the guest and returns its exit code; what it left in /share/out is then in `back` (a path or None)."""
    with tempfile.TemporaryDirectory(prefix="vservo-vm-") as folder:
        folder = Path(folder)
        shared = folder / "back"
        shared.mkdir()
        image = folder / "initramfs"
        with open(image, "wb") as out:
            out.write(machine.initramfs.read_bytes())
            out.write(initramfs.build_run(programs, files, script))
        console = folder / "console"
        emulate(command(machine, image, shared, console, clock), machine, timeout_s, console)
        status = shared / "status"
        if not status.exists():
            raise VmError(f"the guest died before its command ended; its last words:\n{last_words(console)}")
        if back:
            shutil.copytree(shared / "out", back, dirs_exist_ok=True)
            shutil.copy(shared / "dmesg", Path(back) / "dmesg")
        return int(status.read_text())


def command(machine, image, shared, console, clock):
    """The emulator's arguments."""
    root = machine.root
    if clock == "virtual":
        time = ["-accel", "tcg,thread=single", "-icount", f"shift={SHIFT},sleep=off,align=off", "-smp", "1"]
    else:
        time = ["-accel", "tcg,thread=multi", "-smp", "2"]
    return [
        str(initramfs.program_of(root, "qemu-system-x86_64")),
        *["-L", f"{root}/usr/share/qemu", "-L", f"{root}/usr/share/seabios"],
        *["-M", "q35", "-cpu", "max", "-m", str(MEMORY_MIB), *time],
        *["-nodefaults", "-display", "none", "-no-reboot", "-monitor", "none", "-net", "none"],
        *["-kernel", str(machine.kernel), "-initrd", str(image), "-append", KERNEL_LINE],
        *["-serial", "stdio", "-serial", f"file:{console}"],
        *["-fsdev", f"local,id=back,path={shared},security_model=none"],
        *["-device", "virtio-9p-pci,fsdev=back,mount_tag=back"],
    ]


def emulate(arguments, machine, timeout_s, console):
    """Runs the emulator to its end; it dies with this process."""
    process = subprocess.Popen(
        arguments, env=machine.environment(), stdin=subprocess.DEVNULL, preexec_fn=end_with_parent, start_new_session=True
    )
    try:
        code = process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        raise VmError(
            f"the guest was still busy after {timeout_s:g} s and was ended: give it more by --timeout, or look why it hangs; "
            f"its last words:\n{last_words(console)}",
            TIMED_OUT,
        ) from None
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
    if code:
        raise VmError(f"the emulator ended with code {code}; remove {machine.folder} to fetch it anew")


def end_with_parent():
    """In the child: the kernel is to end it when this program is killed, in whatever way."""
    pr_set_pdeathsig = 1
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)


def last_words(console):
    """The end of what the kernel said."""
    lines = console.read_text(errors="replace").splitlines() if console.exists() else []
    return "\n".join(lines[-25:]) or "(none)"
