"""The numbers of the stages: each is read by a stage, and its command exists."""

from __future__ import annotations

import re
import shlex
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import pytest
from measure.command import NAMES

from odt_plugins.cli.compare import compare
from odt_plugins.engine import policy
from odt_plugins.engine.policy import POLICY, Policy

ENGINE = Path(policy.__file__).parent
SOURCES = "".join(path.read_text(encoding="utf-8") for path in ENGINE.parent.rglob("*.py"))


@pytest.mark.parametrize("number", fields(Policy), ids=lambda number: number.name)
def test_a_number_is_read_by_a_stage_and_says_what_it_means(number):
    assert re.search(rf"\bPOLICY\.{number.name}\b", SOURCES)
    assert len(number.metadata["meaning"]) > 15
    documented = " ".join(Policy.__doc__.split())
    assert f"{number.name} : {number.type}, {number.default!r}" in documented
    assert f"``{number.metadata['command']}``" in documented


UNITS = ("Largest", "Least", "Weight", "Factor", "Degrees", "First", "Operations", "Rounds",
         "Passes", "Rings", "Part", "Share", "Shares", "Price")


@pytest.mark.parametrize("number", fields(Policy), ids=lambda number: number.name)
def test_what_a_number_means_is_one_sentence_that_begins_with_its_unit(number):
    said = number.metadata["meaning"]
    assert said.split()[0].rstrip(":") in UNITS
    assert said.endswith(".")
    assert ". " not in said


@pytest.mark.parametrize("command", sorted({n.metadata["command"] for n in fields(Policy)}))
def test_the_command_that_measures_a_number_exists(command):
    program, name, *arguments = shlex.split(command)
    if program == "python":
        assert (ENGINE.parents[1] / name).exists()
        if name == "tests/measure":
            assert set(arguments) <= set(NAMES)
        return
    assert (program, name) == ("odt-plugins", "compare")
    given = compare.make_context(name, list(arguments)).params
    assert given["suite"]


def test_nobody_changes_a_number():
    with pytest.raises(FrozenInstanceError):
        POLICY.settled_rounds = 3
