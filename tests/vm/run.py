#!/usr/bin/env python3
"""Runs a program in a virtual machine whose kernel has real camera drivers (vivid, uvcvideo, vhci-hcd).

    run.py fetch                             fetches the machine's packages into the cache, once
    run.py exec [OPTION]... -- PROGRAM [ARGUMENT]...

PROGRAM is a file of this host, which lies under the same path in the guest, or a command of the guest (sh, v4l2-ctl, mods).
As a cargo runner it runs tests there; programs and config/ of the package come along:

    export CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER="python3 $PWD/tests/vm/run.py exec --"
    cargo test --test v4l2 -- --ignored --test-threads=1

The exit code is the program's own; 124 when it took too long, 125 when the machine did not work. See tests/vm/README.md.
"""

import argparse
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import boot
import packages

#: Exit code when the machine, not the program, failed.
MACHINE_FAILED = 125
#: Variables of the host's environment that the guest gets too.
PASSED_ON = ("RUST_", "VSERVO_", "CARGO_MANIFEST_DIR")


def main():
    arguments = parse()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        machine = packages.provide(tell)
        if arguments.command == "fetch":
            print(machine.folder)
            return 0
        return execute(machine, arguments)
    except packages.VmError as problem:
        tell(problem.args[0])
        return problem.args[1] if len(problem.args) > 1 else MACHINE_FAILED
    except OSError as problem:
        tell(f"{problem.filename}: {problem.strerror}")
        return MACHINE_FAILED


def parse():
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="run.py", description=__doc__, formatter_class=form)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("fetch", help="fetch the machine's packages, once")
    run = commands.add_parser("exec", help="run a program in the guest")
    run.add_argument("--share", type=Path, help="folder that is /share in the guest; its /share/out comes back to SHARE/out")
    run.add_argument("--with", dest="files", type=Path, action="append", default=[], metavar="PATH",
                     help="file or folder that lies under the same path in the guest")
    run.add_argument("--timeout", type=float, default=900, metavar="S", help="longest run, seconds of the host (900)")
    run.add_argument("--clock", choices=["virtual", "real"], default="virtual",
                     help="the guest's clock counts instructions (default), or is the host's")
    run.add_argument("program")
    run.add_argument("arguments", nargs=argparse.REMAINDER)
    return parser.parse_args()


def tell(line):
    print(f"vm: {line}", file=sys.stderr, flush=True)


def execute(machine, arguments):
    """Runs the program; its exit code."""
    with tempfile.TemporaryDirectory(prefix="vservo-vm-programs-") as folder:
        programs, files, path = {}, {}, ["/bin"]
        program = arguments.program
        if Path(program).is_file():
            program = os.path.abspath(program)
            wanted = [Path(program), *programs_of_package(Path(program))]
            programs = {str(p): stripped(p, Path(folder)) for p in wanted}
            path += sorted({str(p.parent) for p in wanted})
        elif "/" in program:
            raise packages.VmError(f"{program}: no such file")
        if arguments.share:
            files |= {f"/share/{p.name}": p for p in arguments.share.iterdir() if p.name != "out"}
        for p in [*files_of_package(), *arguments.files]:
            if not p.exists():
                raise packages.VmError(f"--with {p}: no such file or folder")
            files[os.path.abspath(p)] = p
        script = script_for([program, *arguments.arguments], path)
        back = arguments.share and arguments.share / "out"
        return boot.boot(machine, programs, files, script, back, arguments.timeout, arguments.clock)


def package():
    """The description of the package in whose folder cargo starts its runner; empty elsewhere."""
    description = Path("Cargo.toml")
    return tomllib.loads(description.read_text()) if description.is_file() else {}


def programs_of_package(program):
    """The package's programs, for a test that cargo built: they lie in the folder above."""
    built = program.parent.parent
    names = [b["name"] for b in package().get("bin", [])] if program.parent.name == "deps" else []
    return [built / name for name in names if (built / name).is_file()]


def files_of_package():
    """What programs and tests of the package read."""
    return [Path("config")] if package() and Path("config").is_dir() else []


def stripped(program, folder):
    """A copy without debug information, which would take half of the boot; the file itself where it cannot be had."""
    copy = folder / str(program.absolute()).replace("/", "_")
    if not shutil.which("strip"):
        return program
    done = subprocess.run(["strip", "--strip-debug", "-o", copy, program], capture_output=True)
    return copy if done.returncode == 0 else program


def script_for(words, path):
    """The guest's script: environment, working folder, command."""
    own = {"VSERVO_VM_CACHE"}
    passed = {k: v for k, v in os.environ.items() if k.startswith(PASSED_ON) and k not in own}
    lines = ["#!/bin/sh", f"export PATH={shlex.quote(':'.join(path))}"]
    lines += [f"export {name}={shlex.quote(value)}" for name, value in sorted(passed.items())]
    here = shlex.quote(os.getcwd())
    lines += [f"mkdir -p {here} && cd {here} || exit {MACHINE_FAILED}", f"exec {shlex.join(words)}"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
