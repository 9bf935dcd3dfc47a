"""Records the screen of a diagnosis while the missing effect is added and the error falls: an asciicast, and it as an SVG.

    pip install pyte pexpect
    docs/recording/record.py target/release/drivebench

Writes docs/recording/error-falls.cast (asciicast v2) and docs/error-falls.svg, whose frames are those of the terminal: nothing
is drawn that the program did not print.
"""

import html
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pexpect
import pyte

PROGRAM = str(Path(sys.argv[1]).resolve())
HERE = Path(__file__).resolve().parent
COLUMNS, ROWS = 100, 30
# A screen is settled where its head says so and nothing has come for so long, s; then it is looked at before the next key.
READY, SETTLED_S, LOOK_S, MOST_S = "ready", 1.0, 2.0, 120.0
# A picture of the screen at most so often, s, and the last one so long.
FRAME_S, LAST_S = 0.15, 4.0
# Pieces of output nearer to each other than this belong to one screen.
PIECE_S = 0.05
# Keys: the traces and back, the effect is added, the traces once more.
KEYS = sys.argv[2:] or ["v", "v", "a", "v"]


def record():
    """Output of the program with its times, as the terminal had it."""
    with tempfile.TemporaryDirectory() as folder:
        for name, seed in (("fit", "1"), ("judge", "2")):
            run = [PROGRAM, "run", "--headless", "--port", "sim:", "--out", name, "--run-seed", seed]
            subprocess.run(run, cwd=folder, check=True, capture_output=True)
        fit, judge = (Path(folder, name, "latest").resolve() for name in ("fit", "judge"))
        arguments = ["diagnose", f"fit/{fit.name}", "--holdout", f"judge/{judge.name}", "--screen"]
        child = pexpect.spawn(PROGRAM, arguments, cwd=folder, dimensions=(ROWS, COLUMNS), encoding="utf-8",
                              env={"TERM": "xterm-256color", "PATH": "/usr/bin:/bin", "HOME": folder, "LANG": "C.UTF-8"})
        begun, said = time.monotonic(), []
        screen = pyte.Screen(COLUMNS, ROWS)
        stream = pyte.Stream(screen)

        def settle():
            asked = last = time.monotonic()
            while READY not in screen.display[0] or time.monotonic() - last < SETTLED_S:
                if time.monotonic() - asked > MOST_S:
                    sys.exit(f"the screen did not settle: {screen.display[0]}")
                try:
                    text = child.read_nonblocking(65536, timeout=0.05)
                except pexpect.TIMEOUT:
                    continue
                last = time.monotonic()
                stream.feed(text)
                said.append((last - begun, text))

        settle()
        for key in KEYS:
            time.sleep(LOOK_S)
            child.send(key)
            # The key has been taken once something changes.
            said.append((time.monotonic() - begun, child.read_nonblocking(65536, timeout=10)))
            stream.feed(said[-1][1])
            settle()
        child.send("q")
        child.close()
        return said


def runs(line):
    """Runs of one style in a row: column, text, foreground, background, bold."""
    run = None
    for column in range(COLUMNS):
        cell = line[column]
        fore, back = (cell.bg, cell.fg) if cell.reverse else (cell.fg, cell.bg)
        if cell.reverse:
            fore, back = ("paper" if fore == "default" else fore), ("ink" if back == "default" else back)
        style = [fore, back, cell.bold]
        if run and run[2:] == style:
            run[1] += cell.data
        else:
            if run:
                yield run
            run = [column, cell.data, *style]
    yield run


COLOURS = {"default": "#d8dee4", "ink": "#d8dee4", "paper": "#12161b", "black": "#12161b", "red": "#ff7b72", "green": "#4ac26b",
           "brown": "#e0b040", "blue": "#6cb0ff", "magenta": "#d2a8ff", "cyan": "#56d4dd", "white": "#d8dee4",
           "brightblack": "#7d8894", "brightred": "#ff9a94", "brightgreen": "#7ee787", "brightbrown": "#f2cc60",
           "brightblue": "#9ccbff", "brightmagenta": "#e2c5ff", "brightcyan": "#8ae9f0", "brightwhite": "#ffffff"}
CELL, LINE = 8, 17


def colour(name):
    return COLOURS.get(name, f"#{name}")


def picture(line):
    """One row as SVG."""
    out = []
    for column, text, fore, back, bold in runs(line):
        x, width = column * CELL, len(text) * CELL
        if back != "default":
            out.append(f'<rect x="{x}" width="{width}" height="{LINE}" fill="{colour(back)}"/>')
        if text.strip():
            bare = text.rstrip()
            weight = ' font-weight="bold"' if bold else ""
            fill = "" if fore == "default" else f' fill="{colour(fore)}"'
            length = f' textLength="{len(bare) * CELL}"'
            out.append(f'<text x="{x}" y="13"{length}{fill}{weight}>{html.escape(bare)}</text>')
    return "".join(out)


def frames(said):
    """Screens that differ, as rows, each with the time at which it appears; waits are cut to what a reader needs."""
    screen = pyte.Screen(COLUMNS, ROWS)
    stream = pyte.Stream(screen)
    shown, clock, before, kept = [], 0.0, None, -FRAME_S
    for index, (at, text) in enumerate(said):
        clock += min(at - before, LOOK_S) if before is not None else 0.0
        before = at
        stream.feed(text)
        # Before the screen begins, and from where it is left, there is nothing to see.
        if "\x1b[?1049l" in text:
            break
        # Between two pieces of one screen there is none to be seen.
        rest_s = said[index + 1][0] - at if index + 1 < len(said) else FRAME_S
        last = rest_s >= FRAME_S
        drawn = [picture(screen.buffer[row]) for row in range(ROWS)]
        if (clock - kept >= FRAME_S and rest_s > PIECE_S or last) and sum(map(bool, drawn)) > ROWS // 2:
            if not shown:
                clock = 0.0
            if not shown or shown[-1][1] != drawn:
                shown.append((clock, drawn))
                kept = clock
    return shown


def animated(shown):
    """The frames one after the other, again and again, a row drawn once as long as it stays; a viewer that wants no motion sees
    the last frame."""
    end = shown[-1][0] + LAST_S
    width, height = COLUMNS * CELL, ROWS * LINE
    spans, body = {}, []
    for row in range(ROWS):
        begin = 0
        for index in range(1, len(shown) + 1):
            if index < len(shown) and shown[index][1][row] == shown[begin][1][row]:
                continue
            name = spans.setdefault((begin, index), f"s{len(spans)}")
            last = " last" if index == len(shown) else ""
            if shown[begin][1][row]:
                place = f'transform="translate(0 {row * LINE})"'
                body.append(f'<g class="{name}{last}" {place} xml:space="preserve">{shown[begin][1][row]}</g>')
            begin = index
    style = []
    for (begin, index), name in spans.items():
        at = lambda place: 100 * shown[place][0] / end if place < len(shown) else 100.0
        if begin == 0 and index == len(shown):
            continue
        before = f"0%{{opacity:0}}{at(begin):.2f}%{{opacity:1}}" if begin else "0%{opacity:1}"
        after = f"{at(index):.2f}%,100%{{opacity:0}}" if index < len(shown) else "100%{opacity:1}"
        style.append(f"@keyframes {name}{{{before}{after}}}.{name}{{animation:{name} {end:.2f}s steps(1,end) infinite}}")
    still = "@media (prefers-reduced-motion:reduce){g{animation:none!important;opacity:0}g.last{opacity:1}}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-8 -8 {width + 16} {height + 16}" width="{width + 16}" role="img" '
        'aria-label="The diagnosis on the screen: the missing effect is added and the error falls to the noise floor">'
        '<style>text{font:13px ui-monospace,Menlo,Consolas,"DejaVu Sans Mono",monospace;white-space:pre}'
        f'svg{{fill:{COLOURS["ink"]}}}{"".join(style)}{still}</style>'
        f'<rect x="-8" y="-8" width="{width + 16}" height="{height + 16}" rx="6" fill="{COLOURS["paper"]}"/>'
        f'{"".join(body)}</svg>\n'
    )


said = record()
head = {"version": 2, "width": COLUMNS, "height": ROWS, "env": {"TERM": "xterm-256color"}}
cast = [json.dumps(head)] + [json.dumps([round(at, 3), "o", text]) for at, text in said]
(HERE / "error-falls.cast").write_text("\n".join(cast) + "\n")
shown = frames(said)
(HERE.parent / "error-falls.svg").write_text(animated(shown))
print(f"{len(said)} pieces of output, {len(shown)} frames")
