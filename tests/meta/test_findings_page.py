"""Every code of a finding is explained on its page, and nothing else is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tridentify.estimation.answer.finding import CODES


@pytest.fixture(scope="module")
def sections(repository: Path) -> dict[str, str]:
    """Code -> what its section says."""
    text = (repository / "docs" / "findings.md").read_text(encoding="utf-8")
    parts = re.split(r"^\(([\w-]+)\)=\n## ([\w-]+)\n", text, flags=re.MULTILINE)
    anchors, headings, bodies = parts[1::3], parts[2::3], parts[3::3]
    assert anchors == headings
    return dict(zip(anchors, bodies, strict=True))


def test_every_code_has_a_section_in_the_order_of_the_codes(sections: dict[str, str]) -> None:
    assert list(sections) == list(CODES)


@pytest.mark.parametrize("code", CODES)
def test_a_section_says_what_it_means_and_what_to_do(code: str, sections: dict[str, str]) -> None:
    meaning, _, remedy = sections[code].partition("**What to do.**")
    assert meaning.strip().startswith("**What it means.**")
    assert len(meaning) > 100
    assert len(remedy.strip()) > 40


def test_links_between_findings_lead_somewhere(sections: dict[str, str]) -> None:
    links = [name for body in sections.values() for name in re.findall(r"\(#([\w-]+)\)", body)]
    assert set(links) <= set(CODES)
