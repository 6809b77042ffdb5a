"""The report: one page that needs nothing else, with every bar, plot and failed row in it."""

from __future__ import annotations

import base64
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from asimov_gym.evaluation.bars import BARS
from asimov_gym.evaluation.document import Code, Facts, Folded, Heading, Text, to_markdown
from asimov_gym.evaluation.html import to_html
from asimov_gym.evaluation.report import markdown, summary, tables, write_report
from asimov_gym.evaluation.results import SuiteResult
from asimov_gym.evaluation.table import Table, between, counted, figure, number, percent, vector
from tests.evaluation.made_results import result, scenario, trial, whole_suite

VOID = {"meta", "img", "br", "hr", "link", "input"}


class Page(HTMLParser):
    """Reads a page, and fails where tags are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] != "style":
            self.words.append(data)

    @property
    def text(self) -> str:
        return "".join(self.words)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[SuiteResult, Path]:
    """A whole result, reported."""
    folder = tmp_path_factory.mktemp("run")
    made = whole_suite(folder)
    page = write_report(made, folder)
    assert page == folder / "report.html"
    return made, folder


def test_the_page_stands_alone(written: tuple[SuiteResult, Path]) -> None:
    text = (written[1] / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert "http" not in text.replace("http-equiv", "") and "url(" not in text and "@import" not in text
    assert not {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object", "base"}
    for tag, attributes in page.tags:
        assert not [name for name in attributes if name.startswith("on")]
        if tag != "img":
            assert "src" not in attributes and "href" not in attributes
    assert "prefers-color-scheme: dark" in text and "@media print" in text


def test_the_pictures_are_inside(written: tuple[SuiteResult, Path]) -> None:
    page = Page((written[1] / "report.html").read_text(encoding="utf-8"))
    pictures = [attributes for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) == 6 and all(attributes["alt"] for attributes in pictures)
    files = {path.read_bytes() for path in written[1].glob("*.png")}
    prefix = "data:image/png;base64,"
    assert {base64.b64decode((p["src"] or "").removeprefix(prefix)) for p in pictures} == files


def test_it_tells_bars_failures_conditions_and_how_to_get_it_again(written: tuple[SuiteResult, Path]) -> None:
    made, folder = written
    for text in (Page((folder / "report.html").read_text()).text, (folder / "report.md").read_text()):
        for one in BARS:
            assert one.name in text, one.name
        assert "asimov eval made_up.onnx --suite made" in text
        assert "the simulation diverged after 3.20 s" in text and "not run" in text and "fell at 31.50 s" in text
        assert "mujoco 4.0.0" in text and made.suite_hash in text and made.policy_hash in text
        assert "slope:3, slope:6, slope:10" in text  # what a category changes
        assert "18 trials did not pass" in text
    assert SuiteResult.load(folder) == made


def test_markdown_names_the_pictures_beside_it(written: tuple[SuiteResult, Path]) -> None:
    text = (written[1] / "report.md").read_text()
    for path in written[1].glob("*.png"):
        assert f"]({path.name})" in text


def test_an_incomplete_run_says_so_first(tmp_path: Path) -> None:
    info = scenario("grid/one", (0.5, 0.0, 0.0), 3)
    made = result([info], [trial(info, 0, {"velocity_error_m_s": 0.02})], complete=False)
    page = Page(write_report(made, tmp_path / "new").read_text())
    assert page.text.index("2 of 3 trials are missing") < page.text.index("Bars")
    assert "left out, the suite has no pushes" in page.text
    assert "2 of 3 trials are missing" in summary(made)


def test_the_summary_names_bars_and_where_robots_fell() -> None:
    made = whole_suite()
    lines = summary(made).splitlines()
    assert lines[0] == "made_up.onnx: suite made"
    assert lines[1] == "297 of 298 trials of 75 scenarios run, 280 without a fall, 1 with an error."
    assert any(line.startswith("✗ velocity error over a gait cycle, grid") for line in lines)
    assert any(line.startswith("✓ standing: drift") for line in lines)
    assert "  delay: 20 of 24 trials without a fall" in lines


def test_tables_hold_what_was_measured() -> None:
    found = {table.title: table for table in tables(whole_suite())}
    (delay,) = [row for row in found["By category"].rows if row[0] == "delay"]
    assert delay[1:4] == ("20 of 24", "83.3 %", "64.1 … 93.3")
    assert ("push_standing", "beyond", "1 of 2", "4 of 8", "50.0 %", "350") in found["Pushes by tier"].rows
    assert len(found["Push limits"].rows) == 32
    assert "Figures: grid" in found and "| grid |" in markdown(whole_suite())
    info = scenario("standing/still", repeats=1)
    assert "Pushes" not in {table.title for table in tables(result([info], [trial(info, 0)]))}


def test_foreign_words_cannot_break_the_page() -> None:
    name = '<script>alert("1")</script> & | `'
    table = Table(name, (name,), ((name,),), name)
    blocks = [Heading(name), Text(name), Facts(((name, name),)), Code(name), table, Folded(table)]
    page = Page(to_html(name, blocks))
    assert "script" not in {tag for tag, _ in page.tags}
    assert page.text.count(name) == 15
    assert "\\|" in to_markdown(name, blocks)
    assert "<code>RUN</code>" in to_html("", [Text("see `RUN`")])


def test_numbers_read_as_they_are() -> None:
    assert percent(1.0) == "100 %" and percent(0.9999) == "> 99.9 %" and percent(0.5) == "50.0 %"
    assert percent(None) == number(None) == "–"
    assert number(-0.0001, 2) == "0.00" and number(1.25, 1, "m") == "1.2 m"
    assert figure(0.000123456) == "0.000123" and figure(83.94) == "83.9" and figure(0.0) == "0" and figure(None) == "–"
    assert counted(1, "trial") == "1 trial" and counted(0, "trial") == "0 trials"
    assert vector((0.5, -1e-17, -0.25)) == "+0.50, +0.00, -0.25"
    assert between(0.1, None) == "–" and between(0.1, 0.25, 2) == "0.10 … 0.25"
    with pytest.raises(ValueError, match=r"rows\[0\] must have 2 cells, got 1"):
        Table("t", ("a", "b"), (("1",),))


def test_the_report_can_be_made_again(written: tuple[SuiteResult, Path]) -> None:
    made, folder = written
    before = (folder / "report.html").read_text()
    write_report(replace(made), folder)
    assert (folder / "report.html").read_text() == before
