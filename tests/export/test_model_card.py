"""The card says what is so, and its numbers are those of independent computations."""

import hashlib
import json
import re

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.svm import LinearSVR

from sklearn_raacmm import Arm, PoseFeatures
from sklearn_raacmm.export import ModelCard, describe, export_c, fingerprint

# Chains are fitted without groups: what they learn is not the question here.
pytestmark = pytest.mark.filterwarnings("ignore:No groups were given")


@pytest.fixture(scope="module")
def card(chain, data):
    return describe(chain, data.data, data.target, data.groups)


def test_facts(card, chain, data):
    assert card["fingerprint"] == fingerprint(chain)
    text = json.dumps({"format": "sklearn_raacmm.Arm", "format_version": 1, **card["arm"]})
    assert Arm.from_json(text) == data.arm
    training = card["training"]
    assert (training["rows"], training["positions"]) == (120, 8)
    points = data.arm.forward(data.data)
    assert training["height_mm"] == [points[:, 2].min(), points[:, 2].max()]
    codes = np.unique(data.groups, return_inverse=True)[1]
    digest = hashlib.sha256()
    for values, kind in ((data.data, "<f8"), (data.target, "<f8"), (codes, "<i8")):
        digest.update(str(values.shape).encode() + values.astype(kind).tobytes())
    assert training["data_fingerprint"] == digest.hexdigest()


def test_as_json_and_markdown_and_in_c(card, chain, tmp_path):
    again = ModelCard(json.loads(json.dumps(card)))
    assert again == card
    text = str(again)
    assert text == str(card)
    assert "positions: 8" in text
    source, header = (path.read_text() for path in export_c(chain, tmp_path / "arm.c", card=card))
    assert "positions: 8" in source
    assert "positions: 8" in header
    data_fingerprint = card["training"]["data_fingerprint"]
    assert f'#define ARM_DATA_FINGERPRINT "{data_fingerprint}"' in header


def test_the_arm_to_the_last_digit_that_means_something(data):
    arm = data.arm.replace(a=np.array([600.0224371, 1 / 3, 8.02978570737851e-11, 0, 0, 0]))
    model = PoseFeatures(arm).fit(data.data)
    text = str(describe(model))
    assert "- a, mm: 600.0224371, 0.333333333, 0.0" in text


NAMES = ["Arm 7\n- mean 2S after, mm: 0.0010", "Arm 7\r\n## error", "a\u2028- b", "a\x0b- b"]
NAMES += ["<script>alert(1)</script>", "[x](javascript:alert(1))", "`a` *b* _c_ ![d](e)"]


@pytest.mark.parametrize("name", [*NAMES, "\u202egnirts", "x" * 200])
def test_a_name_cannot_forge_a_line(data, chain, tmp_path, name):
    model = clone(chain).set_params(posefeatures__arm=data.arm.replace(name=name))
    card = describe(model.fit(data.data, data.target))
    assert card["arm"]["name"] == name  # as it is, for JSON
    text = str(card)
    assert len(text.splitlines()) == len(str(describe(chain)).splitlines())
    assert "<" not in text
    assert not re.search(r"(?<!\\)[`*\[]|\u202e", text)
    for path in export_c(model, tmp_path / "arm.c", card=card):
        content = path.read_text(encoding="ascii")
        assert not re.search(r"^ \* - mean 2S", content, re.MULTILINE)
        assert content.count("/*") == content.count("*/")


def test_without_an_arm():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(40, 3)), rng.normal(size=40)
    card = describe(LinearSVR(random_state=0).fit(X, y), X, y)
    assert card["fingerprint"] is None
    assert "arm" not in card
    assert (card["training"]["rows"], card["training"]["positions"]) == (40, None)
    assert "unknown" in str(card)
