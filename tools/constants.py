#!/usr/bin/env python3
"""Numbers of src/ that no comment says the origin of: constants, and thresholds that stand in the code as digits.

Usage: constants.py [FOLDER...]     the numbers of each folder; with folders of src/ named, their places too

A number has an origin where its comment argues: a derivation, a measurement with the test or bench that shows it, a source, or that it
was chosen by hand and what its half and double change. The tool knows that by words alone (`WHY`); whether the reason is right
is for the reader. A comment stands above or beside what it speaks of, above the first of several constants without a blank line between,
or, where it speaks of "the numbers here", in the head of the file.
"""
import collections, pathlib, re, sys

SRC = pathlib.Path(__file__).resolve().parent.parent / "src"
CONST = re.compile(r"\s*(?:pub(?:\([a-z]+\))? )?const (\w+): [^=]*=(.*)")
# 0, 1, 2 and their halves are what a formula is made of.
DIGITS = re.compile(r"(?<![\w.])(?!(?:[012]|0\.0|0\.5|1\.0|2\.0)(?![\w.]))\d[\d_]*(?:\.\d+)?(?:e-?\d+)?")
# Whole numbers in comparisons count things, and the count is the reason.
THRESHOLD = re.compile(r"(?:(?<![<>=-])[<>]=? -?|\.(?:min|max|clamp)\(-?)(?=\d+(?:\.|e-?\d))(" + DIGITS.pattern + ")")
WHY = re.compile(
    r"because|so that|\bsince\b|otherwise|\belse\b|\bwould\b|\bneeds?\b|\bmust\b|chosen|halv|doubl(?:ed|ing)|twice the|measured|\bshows?\b"
    r"|\bbench|\btests?\b|stud(?:y|ies)\b|\bEq\b|\(1\d\.\d+[a-z]?\)|Sect\.|chapter|textbook|standard(?! deviation)|specif|\b(?:RFC|IEC|ISO|ITU)\b|\bpaper\b|\bet al\b"
    r"|deriv|follows|rounding|precision|chi-square|quantile|protocol|kernel's|format's|as (?:\w+ ){1,3}(?:does|do|has|have|says?|asks?)\b",
    re.IGNORECASE,
)


def numbers(text):
    """(line, what) of each number without an origin, and how many were looked at."""
    text = re.split(r"#\[cfg\(test\)\]\n(?:\s*#\[.*\]\n)*\s*(?:pub(?:\([a-z]+\))? )?mod \w+ \{", text)[0]
    head = re.match(r"(?://!.*\n)*", text)[0]
    if "numbers here" in head.lower() and WHY.search(head):
        return [], len(re.findall(r"(?m)^ *(?:pub(?:\([a-z]+\))? )?const \w+:", text))
    lines, found, seen, comment, group = text.split("\n"), [], 0, "", ""
    for at, line in enumerate(lines):
        code, _, beside = line.partition("//")
        if not code.strip():
            comment = comment + beside if beside else ""
            group = "" if not beside else group
            continue
        if start := CONST.match(code):
            value = start[2] + ("" if ";" in start[2] else " ".join(lines[at + 1 : at + 4]))
            group = comment or group
            if DIGITS.search(value):
                seen += 1
                if not WHY.search(group + beside):
                    found.append((at + 1, start[1]))
        elif not code.lstrip().startswith("#["):
            group = ""
            for number in THRESHOLD.finditer(code):
                seen += 1
                if not WHY.search(comment + beside):
                    found.append((at + 1, number[0]))
        if not code.lstrip().startswith("#["):
            comment = ""
    return found, seen


def main():
    without, looked_at, shown = collections.Counter(), collections.Counter(), sys.argv[1:]
    for file in sorted(SRC.rglob("*.rs")):
        path = file.relative_to(SRC)
        if "tests" in path.parts or path.stem in ("tests", "testing", "test_image"):
            continue
        parts = path.parts[1:] if path.parts[0] in ("core", "perception") else path.parts
        folder = parts[0] if len(parts) > 1 else "."
        found, seen = numbers(file.read_text())
        without[folder] += len(found)
        looked_at[folder] += seen
        if folder in shown:
            for line, what in found:
                print(f"src/{path}:{line}: {what}")
    for folder in sorted(looked_at):
        print(f"{without[folder]:5} of {looked_at[folder]:5}  {folder}")
    print(f"{without.total():5} of {looked_at.total():5}  without an origin")


if __name__ == "__main__":
    main()
