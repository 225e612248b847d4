"""The page on formats names what the program reads, and what it shows can be written so."""

from __future__ import annotations

import re
import tomllib

import pytest

from fusion.logs import FORMATS
from fusion.logs.csv.column_map import READY_MAPS
from fusion.logs.manifest.file import make_manifest
from fusion.logs.rosbag.messages import RosType
from tests.files import ROOT

PAGE = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("block", re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL))
def test_settings_on_the_page_are_ones(block: str) -> None:
    values = tomllib.loads(block)
    assert make_manifest(values).model_fields_set >= values.keys()


def test_the_page_names_every_format_map_and_message() -> None:
    words = {word.lower() for name in FORMATS for word in re.findall(r"[A-Za-z-]{3,}", name)} - {"and", "the"}
    assert [word for word in words if word not in PAGE.lower()] == []
    assert [name for name in READY_MAPS if f"`{name}`" not in PAGE] == []
    messages = [kind.value.rpartition("/")[2] for kind in RosType if kind is not RosType.TRANSFORMS]
    told = [name.replace("WithCovarianceStamped", "Stamped") for name in messages]
    assert [name for name in told if name not in PAGE] == []
