"""Reads what a suite writes for machines, as its readers do.

    suite_peer.py JUNIT.xml METRICS.txt RESULT.json

By the rules of the schema that Jenkins' xUnit plugin gives (junit-10): elements, their attributes and children, times. Then with
junitparser and the parser of prometheus_client, where they are installed; what was not read is said.
"""

import json
import re
import sys
import xml.etree.ElementTree as ElementTree

# Element: attributes that it must have, that it may have, and its children.
TEXT = (set(), {"type", "message"}, set())
COUNTS = {"name", "tests", "failures", "errors"}
RULES = {
    "testsuites": (set(), COUNTS | {"time"}, {"testsuite"}),
    "testsuite": (COUNTS, {"time", "skipped", "timestamp", "hostname"}, {"testcase"}),
    "testcase": ({"name"}, {"time", "classname"}, {"skipped", "error", "failure", "system-out"}),
    "skipped": TEXT,
    "error": TEXT,
    "failure": TEXT,
    "system-out": (set(), set(), set()),
}


def check(element):
    must, may, children = RULES[element.tag]
    given = set(element.attrib)
    assert must <= given <= must | may, (element.tag, given)
    if "time" in given:
        assert re.fullmatch(r"[0-9]+(\.[0-9]*)?", element.get("time")), element.get("time")
    if "timestamp" in given:
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", element.get("timestamp")), element.get("timestamp")
    for child in element:
        assert child.tag in children, (element.tag, child.tag)
        check(child)


def legal(text):
    """A text as XML can hold it."""
    return "".join(c for c in text if c in "\n\t" or not (ord(c) < 32 or 127 <= ord(c) < 160 or c in "\ufffe\uffff"))


junit, metrics, result = sys.argv[1:]
outcome = json.load(open(result, encoding="utf-8"))
cases = outcome["cases"]
root = ElementTree.parse(junit).getroot()
assert root.tag == "testsuites"
check(root)
found = [
    (case.get("name"), next((own.tag for own in case if own.tag != "system-out"), "passed"))
    for case in root.iter("testcase")
]
kinds = {"failed": "failure"}
asked = [(legal(f"{own['name']} [seed {own['seed']}]"), kinds.get(own["verdict"], own["verdict"])) for own in cases]
assert found == asked, (found, asked)
print(f"{len(cases)} cases by the rules of the schema")

try:
    import junitparser
except ImportError:
    print("NOT read by junitparser: it is not installed")
else:
    read = junitparser.JUnitXml.fromfile(junit)
    suite = next(iter(read))
    counted = (suite.tests, suite.failures, suite.errors, suite.skipped)
    assert counted == (len(cases), outcome["failed"], outcome["errors"], outcome["skipped"]), counted
    assert [case.name for case in suite] == [name for name, _ in asked]
    reasons = [case.result[0].message for case in suite if case.result]
    assert reasons == [legal(own["reason"]) for own in cases if own["verdict"] != "passed"], reasons
    print(f"{counted[0]} cases by junitparser")

try:
    from prometheus_client.openmetrics.parser import text_string_to_metric_families
except ImportError:
    print("NOT read by prometheus_client: it is not installed")
else:
    families = {own.name: own for own in text_string_to_metric_families(open(metrics, encoding="utf-8", newline="").read())}
    by_verdict = {own.labels["verdict"]: own.value for own in families["drivebench_suite_cases"].samples}
    assert by_verdict["passed"] == outcome["passed"] and by_verdict["failed"] == outcome["failed"], by_verdict
    names = {own.labels["case"] for own in families["drivebench_case_passed"].samples}
    assert names == {own["name"] for own in cases if own["verdict"] != "skipped"}, names
    figures = {(own.labels["case"], own.labels["key"]): own.value for own in families["drivebench_figure"].samples}
    assert figures == {(own["case"], own["key"]): own["mean"] for own in outcome["spread"]}, figures
    print(f"{len(families)} families of metrics by prometheus_client")
