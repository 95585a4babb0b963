"""The report of a batch."""

from __future__ import annotations

import json

from facemime.cli.clips import Clip, write_record
from facemime.cli.report import Entry, Report
from tests.helpers.takes import performance


def recorded(folder, name, record=None):
    """Write the record of a clip that is done."""
    clip = Clip(folder / f"{name}.mp4", f"{name}-1")
    clip.output(folder, ".png").touch()
    write_record(clip, folder, performance(), 1.0, {"1": b"jpeg", "sheet": b"sheet"})
    if record is not None:
        path = clip.output(folder, ".json")
        path.write_text(json.dumps(json.loads(path.read_text()) | record))
    return clip


def test_names_and_messages_are_escaped_in_the_report(tmp_path):
    odd = "<script>alert(1)</script>\udce9"
    recorded(tmp_path, "a", {"missing": "<script>alert(3)</script>", "pictures": ['"><script>alert(2)']})
    Report([Entry(odd, odd, "a-1", odd), Entry(odd, "failed", odd), Entry("b", "failed")], tmp_path).finish()
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<script" not in page and "&lt;script&gt;" in page and "alert(3)" in page


def test_the_report_says_what_is_missing_from_a_clip(tmp_path):
    take = performance()
    take.info["recovered"] = "The video was cut or damaged. Missing: 3.00 s after 2.36 s."
    (tmp_path / "a-1.png").touch()
    write_record(Clip(tmp_path / "a.mp4", "a-1"), tmp_path, take, 1.0, {})
    Report([Entry("a.mp4", "done", "a-1")], tmp_path).finish()
    assert take.info["recovered"] in (tmp_path / "report.html").read_text()


def test_the_report_of_few_clips_is_one_file_and_lists_failures_first(tmp_path):
    recorded(tmp_path, "good")
    entries = [
        Entry("good.mp4", "done", "good-1", least=0.4),
        Entry("<b>.mp4", "failed", "b-1", said="a < b"),
        Entry("late.mp4", "not reached"),
    ]
    Report(entries, tmp_path).finish()
    page = (tmp_path / "report.html").read_text()
    assert "3 clips: 1 done, 1 failed, 1 not reached" in page
    assert page.index("&lt;b&gt;.mp4: failed") < page.index("good.mp4: done") and "a &lt; b" in page
    assert page.count("data:image/jpeg;base64,") == 2 and "<polyline" in page and "http" not in page
    told = json.loads((tmp_path / "report.json").read_text())
    assert told["counts"] == {"done": 1, "skipped": 0, "failed": 1, "not reached": 1}
    assert told["clips"][0]["record"]["pictures"] == ["good-1-1.jpg", "good-1-sheet.jpg"]


def test_the_report_of_many_clips_has_pages_that_are_written_as_clips_end(tmp_path):
    entries = [Entry(f"{number}.mp4", "not reached", f"{number}-1") for number in range(250)]
    report = Report(entries, tmp_path)
    recorded(tmp_path, "7")
    report.ended(7, Entry("7.mp4", "done", "7-1", least=0.3))
    summary = (tmp_path / "report.html").read_text()
    assert "250 clips: 1 done, 249 not reached" in summary and '<a href="report/page-1.html#7-1">7.mp4</a>' in summary
    assert "page-3.html" not in summary, "a page that is not written has no link"
    page = (tmp_path / "report" / "page-1.html").read_text()
    assert 'src="7-1-1.jpg"' in page and "base64" not in page and 'href="../report.html"' in page
    report.ended(249, Entry("249.mp4", "failed", "249-1", said="facemime: no face"))
    report.finish()
    summary = (tmp_path / "report.html").read_text()
    assert 'page-3.html">201 to 250</a></td><td>1 failed, 49 not reached' in summary
    assert 'page-3.html#249-1">249.mp4</a></td><td>no face' in summary
    assert len(json.loads((tmp_path / "report.json").read_text())["clips"]) == 250
