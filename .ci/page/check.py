"""The page of a commission in headless Chromium: nothing on the console, a plot zooms, the numbers are those of result.json.

    check.py RUN_FOLDER [PICTURES]

Ends with status 1 at the first thing that does not hold. With PICTURES the page is left there as PNG: light, dark, print and
390 px wide, to be looked at.
"""

import base64
import json
import re
import shutil
import sys
from pathlib import Path

from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

folder = Path(sys.argv[1]).resolve()
pictures = Path(sys.argv[2]) if len(sys.argv) > 2 else None
result = json.loads((folder / "result.json").read_text())
manifest = json.loads((folder / "manifest.json").read_text())
passed = 0


def check(holds, what):
    global passed
    if not holds:
        sys.exit(f"FAIL {what}")
    passed += 1
    print(f"ok   {what}")


options = webdriver.ChromeOptions()
for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"):
    options.add_argument(argument)
options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))


def script(text, *values):
    return browser.execute_script(text, *values)


def size(width, height=1000):
    """The window without its frame, which a headless browser counts too."""
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
    )


def media(name="", scheme="light"):
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": name, "features": features})


def look(name):
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
        metrics = browser.execute_cdp_cmd("Page.getLayoutMetrics", {})["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": metrics["width"], "height": metrics["height"], "scale": 1}
        shot = browser.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True, "clip": clip})
        (pictures / f"{name}.png").write_bytes(base64.b64decode(shot["data"]))


def paths(svg):
    return script("return [...arguments[0].querySelectorAll('path.series')].map(path => path.getAttribute('d'))", svg)


def labels(svg):
    """Numbers along the axis."""
    return script("return [...arguments[0].querySelectorAll('g.axis text')].map(text => Number(text.textContent))", svg)


def drag(svg, begin, end):
    """Along the picture, in shares of its width."""
    box = svg.rect
    x = lambda share: int(box["width"] * (share - 0.5))
    actions = ActionChains(browser).move_to_element_with_offset(svg, x(begin), 0).click_and_hold()
    actions.move_by_offset(x(end) - x(begin), 0).release().perform()
    settle()


def settle():
    browser.execute_async_script("const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(done))")


try:
    size(1000)
    media()
    browser.get((folder / "report.html").as_uri())
    look("light")

    about = {row.find_element(By.TAG_NAME, "dt").text: row.find_element(By.TAG_NAME, "dd").text
             for row in browser.find_elements(By.CSS_SELECTOR, "header dl div")}
    digits = re.sub(r"\D", "", about["date"])
    check(digits == re.sub(r"\D", "", manifest["stamp"]), f"the page begins with the date of the run, {about['date']}")
    check(about["serial number"] == manifest["identity"]["serial_number"], f"serial number {about['serial number']}")
    check(about["drive"] and about["motor"] != "not told", f"drive {about['drive']}, motor {about['motor']}")

    text = script("return document.body.innerText")
    for rung in result["ladder"]:
        name = " + ".join(["baseline", *rung["effects"]])
        row = f"{rung['holdout_rmse']:.2f}"
        check(re.search(rf"{re.escape(name)}\s+{row}", text), f"held-out error of {name} is {row}")
    for effect in result["diagnosis"]["effects"]:
        check(f"({effect})" in text, f"the card of {effect}")
    rows = {}
    for row in script("return [...document.querySelectorAll('tbody tr')].map(r => [...r.cells].map(c => c.innerText))"):
        rows.setdefault(row[0], row)
    head = script("return [...document.querySelectorAll('table')].map(t => [...t.tHead.rows[0].cells].map(c => c.innerText))"
                  ".find(head => head[0] === 'parameter')")
    column = next(head.index(name) for name in ("after ± std", "estimate ± std") if name in head)
    for estimate in result["parameters"]:
        key = estimate["key"]
        if estimate["value"] is None:
            continue
        # The effect stands before a key where two rows would have the same.
        row = rows.get(key) or rows[key.rpartition(".")[2]]
        shown = re.match(r"\(?(-?[\d.]+)(?:e(-?\d+))?", row[column].replace("−", "-"))
        power = 10.0 ** int(shown[2] or 0)
        last = 10.0 ** -len(shown[1].partition(".")[2]) * power
        same = abs(float(shown[1]) * power - estimate["value"]) <= 0.51 * last
        check(same, f"{key}: {row[column].splitlines()[0]} is {estimate['value']}")

    plots = browser.find_elements(By.CSS_SELECTOR, "svg.panels")
    check(plots, f"{len(plots)} plot over time")
    plot = plots[0]
    before, axis = paths(plot), labels(plot)
    check(axis[0] < 1.0, f"time counts from the start of the run: {axis[0]}")
    drag(plot, 0.4, 0.5)
    zoomed = labels(plot)
    check(paths(plot) != before, "a drag zooms the plot")
    check(max(zoomed) - min(zoomed) < 0.2 * (max(axis) - min(axis)), f"from {axis} to {zoomed}")
    ActionChains(browser).move_to_element_with_offset(plot, 30, 0).perform()
    readouts = script("return [...arguments[0].querySelectorAll('.readout')].map(text => text.textContent)", plot)
    check(any("measured" in values for values in readouts), f"values at the cursor: {readouts}")
    ActionChains(browser).double_click(plot).perform()
    settle()
    check(labels(plot) == axis, "a double click shows the whole again")

    entry = plot.find_element(By.CSS_SELECTOR, ".entry:last-of-type text")
    whole = paths(plot)
    entry.click()
    check("" in paths(plot), "the legend hides a line")
    entry.click()
    check(paths(plot) == whole, "and shows it again")

    slider = browser.find_elements(By.CSS_SELECTOR, ".tools input[type=range]")
    if result["diagnosis"]["effects"]:
        check(slider, "a divider between the models before and after")
        script("arguments[0].value = 500; arguments[0].dispatchEvent(new Event('input'))", slider[0])
        ends = script("""
            const plot = arguments[0], places = (kind, pick) => pick(...[...plot.querySelectorAll(`path.series.${kind}`)]
                .flatMap(path => [...path.getAttribute('d').matchAll(/[ML]([-\\d.]+)/g)].map(match => Number(match[1]))));
            return [places('before', Math.max), places('after', Math.min)];""", plot)
        check(abs(ends[0] - ends[1]) < 10, f"the model before ends where the one after begins: {ends}")

    # What an error in the script would leave, and what a page on its own must never do.
    said = browser.get_log("browser")
    check(not said, f"nothing on the console: {said}")
    fetched = script("return performance.getEntriesByType('resource').map(entry => entry.name)")
    check(not fetched, f"nothing is fetched: {fetched}")

    colours = "const style = getComputedStyle(document.body); return [style.backgroundColor, style.color]"
    bright = lambda colour: sum(int(part) for part in re.findall(r"\d+", colour)[:3]) / 3
    media(scheme="dark")
    paper, ink = script(colours)
    check(bright(paper) < 60 and bright(ink) > 180, f"dark: {ink} on {paper}")
    look("dark")
    media("print", "dark")
    paper, ink = script(colours)
    check(bright(paper) > 240 and bright(ink) < 60, f"print: {ink} on {paper}, whatever the screen")
    check(script("return getComputedStyle(document.querySelector('.tools')).display") == "none", "no buttons on paper")
    look("print")
    pdf = base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": False})["data"])
    check(pdf.startswith(b"%PDF") and len(pdf) > 20_000, f"printed: {len(pdf)} bytes")
    media()
    size(390, 844)
    check(script("return document.documentElement.scrollWidth") <= 390, "390 px wide without scrolling sideways")
    look("narrow")

    shapes = "return [...document.querySelectorAll('svg.plot')].map(svg => [svg.getBoundingClientRect().height > 50, svg.textContent.length > 20])"
    size(1000)
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    browser.get((folder / "report.html").as_uri())
    drawn = script(shapes)
    check(drawn and all(all(one) for one in drawn), f"{len(drawn)} pictures without script")
    check(not browser.find_elements(By.CSS_SELECTOR, ".tools"), "and no buttons that would do nothing")
finally:
    browser.quit()
print(f"\n{passed} passed, 0 failed")
