"""Every reader with inputs changed at random: it reads them, or refuses them in a line, and does nothing else.

What is changed are the small files of `tests.reader_targets`; words that have been trouble are put in, parts
repeated, moved, cut and flipped.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.reader_targets import TARGETS, TEXTS, kept, survives

WORDS = (
    b"", b"\0", b"\x1b[2J", b"\xff", b"\xef\xbb\xbf", b"\r", b"\n\n", b'"', b"'", b"#", b",", b";", b"\t", b":", b"=",
    b"[", b"]", b"{", b"}", b"&a ", b"*a", b"<<: *a", b"!!python/object:os.system ", b"%YAML:1.0\n---\n", b".inf",
    b"nan", b"-", b"0", b"-1", b"1e400", b"1e-400", b"9" * 25, b"9" * 400, b"9" * 5000, b"18446744073709551616",
    b"true", b"null", b"../../x", b"~nosuchuser/x", b"/dev/zero", b"x" * 140_000, b"a." * 600, b"[" * 2000,
    b"\xe2\x80\xae",
)  # fmt: skip


@st.composite
def changed(draw: st.DrawFn, corpus: list[bytes]) -> bytes:
    """One of the corpus with up to four changes."""
    data = draw(st.sampled_from(corpus))
    for _ in range(draw(st.integers(0, 4))):
        start = draw(st.integers(0, len(data)))
        end = min(len(data), start + draw(st.sampled_from((0, 0, 1, 2, 8, 40, len(data)))))
        put = draw(
            st.one_of(
                st.sampled_from(WORDS),
                st.binary(max_size=6),
                st.just(data[start:end] * 2),
                st.sampled_from(data.split(b"\n")),
            )
        )
        data = data[:start] + put + data[end:]
    return data


FUZZ = settings(max_examples=150, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.mark.parametrize("name", TEXTS)
def test_changed_at_random(folder: Path, name: str) -> None:
    target = TEXTS[name]

    @FUZZ
    @given(data=changed(target.seeds()))
    def reads_or_refuses(data: bytes) -> None:
        survives(target, data, folder)

    reads_or_refuses()


@pytest.mark.parametrize(
    ("name", "path"),
    [pytest.param(name, path, id=f"{name}-{path.name}") for name in TARGETS for path in kept(name)],
)
def test_what_failed_once(tmp_path: Path, name: str, path: Path) -> None:
    survives(TARGETS[name], path.read_bytes(), tmp_path)
