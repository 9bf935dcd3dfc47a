"""Each case of a suite as a test of pytest: the suite runs once, its JSON says how each case went.

    DRIVEBENCH=target/release/drivebench DRIVEBENCH_SUITE=suite.toml pytest examples/pytest
"""

import json
import os
import pathlib
import subprocess

import pytest

PROGRAM = os.environ.get("DRIVEBENCH", "drivebench")
SUITE = os.environ.get("DRIVEBENCH_SUITE", str(pathlib.Path(__file__).with_name("bench.toml")))


def drivebench(*words):
    """The JSON of a command. Cases that did not pass are in it, and end the command with a status of their own."""
    done = subprocess.run([PROGRAM, *words, "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if not done.stdout:
        pytest.fail(f"status {done.returncode}: {done.stderr}")
    return json.loads(done.stdout)


@pytest.fixture(scope="session")
def outcome(tmp_path_factory):
    return drivebench("test", SUITE, "--out", str(tmp_path_factory.mktemp("suites")))


@pytest.mark.parametrize("name", [case["name"] for case in drivebench("test", SUITE, "--list")])
def test_case(name, outcome):
    repeats = [case for case in outcome["cases"] if case["name"] == name]
    assert repeats, "the suite was interrupted"
    wrong = [case for case in repeats if case["verdict"] in ("failed", "error")]
    assert not wrong, "\n".join(f"seed {case['seed']}: {case['reason']}, see {case['evidence']}" for case in wrong)
    if all(case["verdict"] == "skipped" for case in repeats):
        pytest.skip(repeats[0]["reason"])


def test_the_resistance_hardly_differs_from_run_to_run(outcome):
    """What the suite has no limit for is judged from its figures."""
    spread = next(own for own in outcome["spread"] if own["key"] == "resistance_ohm")
    assert spread["std"] < 0.01 * spread["mean"]
