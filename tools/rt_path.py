#!/usr/bin/env python3
"""What an audit of the 1 kHz thread reads: the modules that its code names, and those that they name.

Usage: rt_path.py [--root FOLDER]     prints lines, lines of code and path of each file, and their sum

Lines are those of a file without its tests; lines of code are those without comments and blanks too. A name that a folder hands on
leads to the file that it comes from, and a method to the file below its type's where it stands. What a trait object stands for no path names: all that implement such a trait count. Not
followed: what the thread calls neither while it ticks nor at its end, what the mission beside it does, and the drives and links of simulations.
"""
import argparse, pathlib, re

# The thread; what stands behind its traits on a real arm; and methods of `Robot` that no path names.
ROOTS = ["process/control/realtime_thread", "process/control/drive_rings", "drive/external", "robot/dynamics"]
# Traits whose objects the thread calls, beside those of the drive: what implements them belongs to the path. None so far.
TRAITS = []
# The record that is made of the histograms at the end, and how the page of the stop word is made, before the thread is.
NOT_FOLLOWED = ["report/summary", "ipc/stop_word/file"]


def without_tests(text):
    text = re.sub(r"#\[cfg\(test\)\]\n(pub(\([a-z]+\))? )?(mod|use) [^;{]*;\n", "", text)
    return re.split(r"#\[cfg\(test\)\]\nmod ", text)[0]


def names(prefix, text):
    """`a::{b, c::d}` names a::b and a::c::d."""
    word = re.match(r"[A-Za-z0-9_:]*", text)[0]
    rest = text[len(word) :]
    parts = prefix + [part for part in word.split("::") if part]
    if not (word.endswith("::") and rest.startswith("{")):
        return [parts]
    depth, item, found = 0, "", []
    for c in rest:
        depth += {"{": 1, "}": -1}.get(c, 0)
        if (c == "," and depth == 1) or depth == 0:
            found += names(parts, item.strip())
            item = ""
            if depth == 0:
                break
        elif not (c == "{" and depth == 1):
            item += c
    return found


class Tree:
    def __init__(self, src):
        self.code = {}
        self.file = {}
        for file in src.rglob("*.rs"):
            path = file.relative_to(src).with_suffix("").parts
            if path[-1] == "lib" and len(path) > 1:
                continue
            path = path[:-1] if path[-1] in ("mod", "lib") else path
            # The crates below show their modules under the name of the whole.
            path = path[1:] if path[:1] in (("core",), ("perception",)) else path
            self.file[path] = without_tests(file.read_text())
            self.code[path] = re.sub(r"//.*", "", self.file[path])

    def modules_of(self, module, parts, depth=0):
        """The modules that a path, written in `module`, leads to."""
        base = list(module)
        while parts and parts[0] in ("crate", "self", "super"):
            base = {"crate": [], "self": base, "super": base[:-1]}[parts[0]]
            parts = parts[1:]
        full = tuple(base + parts)
        end = next(n for n in range(len(full), -1, -1) if full[:n] in self.code)
        there, item = full[:end], full[end : end + 1]
        handed_on = set()
        if item and depth < 4:
            for use in re.finditer(r"pub(?:\([a-z]+\))? use ([^;]+);", self.code[there]):
                for path in names([], " ".join(use[1].split()).replace("{ ", "{")):
                    if path[-1] == item[0] and len(path) > 1:
                        path = path if path[0] in ("crate", "self", "super") else ["self"] + path
                        handed_on |= self.modules_of(there, path, depth + 1)
        return handed_on or {there}

    def uses(self, module):
        found = set()
        for start in re.finditer(r"(?<![\w:])(?:crate|super|self)::", self.code[module]):
            for parts in names([], self.code[module][start.start() :]):
                found |= self.modules_of(module, parts)
        for start in re.finditer(r"(?<![\w:])rt::(\w+)", self.code[module]):
            found |= self.modules_of(module, ["crate", "rt", start[1]])
        # Modules of its own: what it takes from them for itself, and does not only hand on.
        for child in re.findall(r"^ *(?:pub(?:\([a-z]+\))? )?mod (\w+);", self.code[module], re.M):
            if module + (child,) not in self.code:
                continue
            body = re.sub(r'"(?:\\.|[^"\\])*"', "", re.sub(r"\b(?:use|mod) [^;]*;", "", self.code[module]))
            uses = re.findall(rf"\buse {child}::([^;]*);", self.code[module])
            items = [path[-1] for use in uses for path in names([], "x::" + " ".join(use.split()))]
            if re.search(rf"(?<![\w:]){child}::", body) or any(re.search(rf"\b{item}\b", body) for item in items):
                found.add(module + (child,))
            # Methods of a type of this module that stand there.
            own = module + (child,)
            beside = "".join(code for other, code in self.code.items() if other[:1] == module[:1] and other != own)
            methods = re.findall(r"\bfn (\w+)\s*[<(]", self.code[own])
            types = re.findall(r"^(?:pub(?:\([a-z]+\))? )?(?:struct|enum) (\w+)", self.code[module], re.M)
            extends = any(re.search(rf"^impl(?:<[^{{]*>)? {name}\b", self.code[own], re.M) for name in types)
            if extends and any(re.search(rf"\.{method}\(", beside) for method in methods):
                found.add(own)
        for trait in re.findall(r"\bdyn (?:\w+::)*(\w+)", self.code[module]):
            if trait in TRAITS:
                implements = re.compile(rf"\bimpl<[^{{;]*>\s+{trait}\b[^{{;]*\bfor\b")
                found |= {other for other, code in self.code.items() if implements.search(code)}
        return found - {module, ()}


def main():
    arguments = argparse.ArgumentParser(usage=__doc__)
    arguments.add_argument("--root", type=pathlib.Path, default=pathlib.Path(__file__).parent.parent)
    tree = Tree(arguments.parse_args().root / "src")
    stops = {tuple(stop.split("/")) for stop in NOT_FOLLOWED}
    seen, left = set(), [tuple(root.split("/")) for root in ROOTS]
    while left:
        module = left.pop()
        if module not in seen and module not in stops:
            seen.add(module)
            left += tree.uses(module)
    sums = [0, 0]
    for module in sorted(seen):
        lines = tree.file[module].splitlines()
        code = [line for line in lines if line.strip() and not line.strip().startswith("//")]
        sums = [sums[0] + len(lines), sums[1] + len(code)]
        print(f"{len(lines):5} {len(code):5} {'/'.join(module)}")
    print(f"{sums[0]:5} {sums[1]:5} in {len(seen)} files")


if __name__ == "__main__":
    main()
