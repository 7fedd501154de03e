import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest

from dropstitch.__main__ import main
from hil.report.build_inputs import LoopRun, read_build
from hil.report.loop_figures import loop_figures
from hil.report.report_page import report_page
from hil.report.report_tables import prediction_table, results_table, verdict_sentence
from hil.report.study.motion_figures import motion_figures
from hil.sil.timing_verdict import TimingVerdict, judge_timing
from models.shared.drawing import Drawing
from models.trials.origin import TrialOrigin


class Page(HTMLParser):
    """Tags, attributes and visible text of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.words, self._hidden = [], [], 0
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._hidden += tag == "style"

    def handle_endtag(self, tag):
        self._hidden -= tag == "style"

    def handle_data(self, data):
        if not self._hidden:
            self.words.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.words))


@pytest.fixture(scope="session")
def html(page):
    return page.read_text(encoding="utf-8")


@pytest.fixture
def copy(build, tmp_path):
    """The build directory, free to be damaged."""
    return shutil.copytree(build, tmp_path / "build", ignore=shutil.ignore_patterns("*.html"))


@pytest.fixture
def copy_1dof(copy):
    """The same without 2DOF studies, whose drawings cost most of a page."""
    for path in copy.glob("*2dof*"):
        shutil.rmtree(path)
    return copy


def test_the_page_needs_nothing_but_itself(page, html):
    assert page.stat().st_size < 2_000_000
    for tag, attributes in Page(html).tags:
        assert tag not in ("script", "iframe", "object", "img")
        for name in ("src", "href", "xlink:href", "action", "srcset"):
            assert attributes.get(name, "#").startswith(("#", "data:")), (tag, attributes)
    assert not re.search(r"@import|url\((?!#)", html)


def test_the_first_screen_says_where_the_trials_come_from(html):
    before, after = html.split('<p class="notice unknown" role="note"><strong>Origin not stated')
    assert "<h1>" in before and 'class="lead"' not in before
    assert 'class="notice simulated"' in after.split('class="lead"')[0]  # the loop is emulated


def test_text_of_drawings_is_dark(html):
    """Drawings stand on a light plate, so text of 4.5 on white is legible in every scheme."""
    for style in re.findall(r"<text\b[^>]*style=\"([^\"]*)\"", html):
        if colour := re.search(r"fill: (#\w{6})", style):
            luminance = sum(
                weight * ((v / 255 + 0.055) / 1.055) ** 2.4
                for weight, v in zip(
                    (0.2126, 0.7152, 0.0722), bytes.fromhex(colour[1][1:]), strict=True
                )
            )
            assert 1.05 / (luminance + 0.05) >= 4.5, colour[1]


def test_every_reference_has_one_target(html):
    tags = Page(html).tags
    ids = [a["id"] for _, a in tags if "id" in a]
    assert len(ids) == len(set(ids))
    wanted = {v[1:] for _, a in tags for n, v in a.items() if n.endswith("href") and v[0] == "#"}
    wanted |= set(re.findall(r"url\(#([^)]+)\)", html))
    assert wanted and wanted <= set(ids)


def test_every_drawing_is_sound_described_and_scales(html):
    drawings = re.findall(r'<div role="img" aria-label="([^"]+)">(<svg.*?</svg>)', html, re.DOTALL)
    assert len(drawings) == html.count("<figure>") > 20
    for description, svg in drawings:
        assert len(description) > 40
        root = ElementTree.fromstring(svg)
        assert "viewBox" in root.attrib and "width" not in root.attrib
        assert "font-family" not in svg
        assert "nan" not in description.lower()


def test_all_the_papers_figures_are_there(html):
    text = Page(html).text
    for number in ("7", "8", "9 and 10", "11", "12 and 13", "14", "15"):
        assert f"paper, Fig. {number} " in text
    for word in ("1DOF, trial 2", "2DOF, unseen 20° motion", "2DOF, phase 90°"):
        assert word in text


def test_the_tables_hold_the_inputs_figures(build, html):
    text = Page(html).text.replace("\u00a0", " ")
    study = json.loads((build / "bundle_2dof" / "study.json").read_text())
    degree = str(study["chosen_degree"])
    table = study["mean_euclidean_distance_m"]["unseen_20deg"]["pooled"]
    figures = [f"{1e3 * table[v][degree]:.1f}" for v in ("without_di", "estimated_di", "with_di")]
    assert f"2DOF, all phases, unseen 20° motion {degree}" in text and " ".join(figures) in text
    check = json.loads((build / "check_twin_1dof.json").read_text())
    assert all(c["detail"] in text for c in check["checks"])
    for finding in study["findings"]:
        assert finding["claim"] in text and finding["depends_on"] in text


def test_every_phase_has_its_study_beside_the_one_of_all(build, html):
    inputs = read_build(build)
    assert list(inputs.motions) == ["1DOF", "2DOF, phase 0°", "2DOF, phase 90°"]
    assert list(inputs.every_study) == [*inputs.motions, "2DOF, all phases"]
    assert inputs.every_study["2DOF, all phases"] is inputs.studies[2]
    (figure,) = [f for f in motion_figures(inputs.motions) if f.title == "Mean DI by payload"]
    (panel,) = figure.panels
    for motion, study in inputs.motions.items():
        assert f"{motion}: {100 * study.mean_di['0']:.2f}\u00a0% at 0 kg" in panel.alt
    badges = re.findall(r'class="badge (\w+)">(.*?)</span>', html)
    words = {"met": "comes out", "unmet": "does not come out", "unknown": "cannot be told"}
    assert {text for _, text in badges} >= {f"1DOF, origin not stated: {words[badges[0][0]]}"}
    assert {text.split(",")[0] for _, text in badges} == {"1DOF", "2DOF"}
    assert all(text.endswith(f", origin not stated: {words[kind]}") for kind, text in badges)


def grown(document, factor):
    """The study of a link that is larger by a factor."""
    paths = {
        name: msgspec.structs.replace(
            path, **{k: tuple(factor * v for v in getattr(path, k)) for k in path.__struct_fields__}
        )
        for name, path in document.series.path.items()
    }
    poses = document.series.poses
    line_m = tuple(
        tuple(tuple(None if v is None else factor * v for v in point) for point in line)
        for line in poses.centre_line_m
    )
    poses = msgspec.structs.replace(poses, centre_line_m=line_m)
    series = msgspec.structs.replace(document.series, path=paths, poses=poses)
    return msgspec.structs.replace(document, series=series)


def test_a_bundle_alone_is_drawn_with_all_its_phases(copy, monkeypatch):
    for phase in (0, 90):
        shutil.rmtree(copy / f"study_2dof_phase{phase}")
    inputs = read_build(copy)
    assert list(inputs.every_study) == ["1DOF", "2DOF"]
    drawn, show = [], Drawing.panel
    monkeypatch.setattr(Drawing, "panel", lambda d, *a: (drawn.append(d), show(d, *a))[1])
    paths, *_ = motion_figures({"2DOF": grown(inputs.studies[2], 5.0)})
    for ax in [ax for drawing in drawn for ax in drawing._figure.axes]:
        box = ax.viewLim
        inside = [box.x0 <= x <= box.x1 and box.y0 <= y <= box.y1
                  for line in ax.lines for x, y in line.get_xydata()]  # fmt: skip
        assert all(inside), (ax.get_xlabel(), box)
    assert [label for _, label, _ in paths.legend][:2] == ["0 kg, phase 0°", "0 kg, phase 90°"]


def test_commands_stand_once_in_the_order_of_their_last_run(build, html):
    lines = (build / "commands.log").read_text().splitlines()
    listed = re.findall(r"<li><code>(.*?)</code>", html)
    assert listed == lines[1:]


def test_the_same_inputs_give_the_same_page(build, html):
    again = report_page(read_build(build))
    one, two = (re.sub(r"Written .*? UTC", "", text) for text in (html, again))
    assert one == two


def test_text_from_files_is_text(copy):
    for name in ("bundle_1dof", "study_2dof_phase0", "study_2dof_phase90", "sil_1dof"):
        shutil.rmtree(copy / name)  # one study is enough
    path = copy / "bundle_2dof" / "study.json"
    study = json.loads(path.read_text())
    study["findings"][0]["text"] = "<script>alert(1)</script> & more"
    path.write_text(json.dumps(study))
    (copy / "commands.log").write_text("dropstitch report build --out '<b>'\n")
    html = report_page(read_build(copy))
    assert "<script>" not in html and "&lt;script&gt;" in html and "&lt;b&gt;" in html


@pytest.mark.parametrize(
    ("missing", "rest"),
    [
        (
            {"bundle_1dof": "dropstitch train", "bundle_2dof": "dropstitch train",
             "study_2dof_phase0": "dropstitch train",
             "study_2dof_phase90": "dropstitch train", "commands.log": "make demo"},
            "twin_1dof",
        ),
        (
            {"evaluate_unseen_20deg.json": "dropstitch evaluate",
             "check_twin_1dof.json": "dropstitch fmu check", "sil_1dof": "dropstitch sil"},
            "Paths of the end",
        ),
    ],
)  # fmt: skip
def test_a_section_without_inputs_says_what_makes_them(copy, missing, rest):
    for name in missing:
        path = copy / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    for path in copy.glob("*2dof*"):  # the 1DOF study is enough for the sections that stay
        shutil.rmtree(path)
    text = Page(report_page(read_build(copy))).text
    for command in missing.values():
        assert re.search(rf"Not shown: [^.]*\. To create them, run {re.escape(command)}", text)
    assert rest in text


def test_one_dof_alone_is_enough(copy_1dof):
    text = Page(report_page(read_build(copy_1dof))).text
    assert "1DOF, trial 2" in text and "2DOF, trial 2" not in text


def test_an_empty_directory_gives_a_page_of_instructions(tmp_path, capsys):
    assert main(["report", "build", str(tmp_path), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    text = Page((tmp_path / "report.html").read_text()).text
    assert result["bytes"] == (tmp_path / "report.html").stat().st_size
    assert text.count("Not shown") == 8


@pytest.mark.parametrize("damage", ["{", "[1]", "\xff\xfe"])
def test_a_damaged_file_gets_one_sentence(copy, capsys, damage):
    (copy / "check_twin_1dof.json").write_bytes(damage.encode("latin-1"))
    assert main(["report", "build", str(copy)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "check_twin_1dof.json" in err and "write it again" in err
    assert main(["report", "build", str(copy / "none")]) == 2


@pytest.mark.parametrize(
    ("name", "command"),
    [("bundle_1dof/study.json", "dropstitch train"), ("sil_1dof/timing.json", "dropstitch sil")],
)
def test_a_file_of_an_older_version_gets_one_sentence_with_the_command(copy, capsys, name, command):
    document = json.loads((copy / name).read_text())
    (copy / name).write_text(json.dumps(document | {"schema": 1}))
    assert main(["report", "build", str(copy)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "schema version 1" in err and command in err


def row_of(table, words):
    (row,) = [r for r in table.cells if words in r[0].text]
    return row


@pytest.mark.parametrize(("gain", "met"), [(0.91, True), (0.9, True), (0.89, False)])
def test_gains_are_judged_by_their_target(build, gain, met):
    inputs = read_build(build)
    observer = inputs.studies[1].estimators["trial_2"]["observer"]
    observer.benefit_recovered["3"] = gain
    cell = row_of(results_table(inputs), "degree 3, trial 2")[2]
    assert (cell.text, cell.met) == (f"{gain:.0%}".replace("%", "\u00a0%"), met)


@pytest.mark.parametrize(
    ("rms_m", "rig", "met"),
    [(0.0016, "default", True), (0.0018, "default", False), (0.0018, "test_a", None)],
)
def test_the_glance_judges_errors_of_the_default_rig(build, rms_m, rig, met):
    """Targets were set on the default rig; trials of another origin are shown without one."""
    inputs = read_build(build)
    title = "unseen 20° motion"
    evaluation = inputs.evaluations[title]
    evaluation.dof["1"] = msgspec.structs.replace(evaluation.dof["1"], tip_rms_m=rms_m)
    origins = (TrialOrigin("rig", rig, evaluation.trials),)
    inputs.evaluations[title] = msgspec.structs.replace(evaluation, origins=origins)
    row = row_of(results_table(inputs), "Tip error (RMS)")
    assert row[2].met is met
    assert (row[1].text == "–") is (met is None)


def test_what_was_not_measured_is_not_judged(tmp_path):
    table = results_table(read_build(tmp_path))
    assert len(table.rows) >= 6
    assert all(cell.met is None for row in table.cells for cell in row[2:])


def test_simulated_time_makes_no_claim_about_cost(build, html):
    inputs = read_build(build)
    (loop,) = inputs.loops
    assert (loop.dof, loop.line, loop.in_real_time) == (1, "virtual", False)
    assert [c.met for c in row_of(results_table(inputs), "Own cost")[2:]] == [None, None]
    assert "Durations in ms" not in html
    (figure,) = loop_figures(loop)
    assert figure.title == "Tip predicted by the robot"


def test_prediction_and_plant_are_compared_tick_by_tick(build):
    (loop,) = read_build(build).loops
    predicted_m = np.column_stack([loop.ticks[f"predicted_tip_{axis}_m"] for axis in "xyz"])
    distance_m = np.linalg.norm(predicted_m - loop.true_tip_m, axis=1)
    error = loop.timing.prediction_error
    assert error.n == len(distance_m)
    assert distance_m.mean() == pytest.approx(error.mean_euclidean_distance_m, rel=1e-9)
    assert distance_m.max() == pytest.approx(error.max_m, rel=1e-9)


def test_the_error_is_listed_by_part_of_the_run(build):
    (loop,) = read_build(build).loops
    table = prediction_table(loop)
    parts = loop.timing.prediction_error.parts
    assert row_of(table, "all ticks")[1].text == str(loop.timing.prediction_error.n)
    counts = [int(row_of(table, w)[1].text) for w in ("rest between", "motion, as", "stop")]
    assert sum(counts) == loop.timing.prediction_error.n  # three seconds reach no glide
    assert row_of(table, "motion, as")[2].text == (
        f"{1e3 * parts['motion'].mean_euclidean_distance_m:.1f}"
    )


@pytest.fixture
def slow_run(build):
    """The same run as if in real time, with one slow tick of our own doing among many."""
    (loop,) = read_build(build).loops
    ticks = {name: column.copy() for name, column in loop.ticks.items()}
    ticks["busy_ns"][:] = 2_000_000
    ticks["bus_wait_ns"][:] = 1_400_000
    ticks["lateness_ns"][:] = 50_000
    ticks["busy_ns"][100] = 19_000_000
    dtype = [(name, np.float64 if "_ns" not in name else np.int64) for name in ticks]
    records = np.empty(len(ticks["tick"]), dtype)
    for name, column in ticks.items():
        records[name] = column
    judged = judge_timing(records, 0.017)
    timing = msgspec.structs.replace(
        loop.timing,
        environment=msgspec.structs.replace(loop.timing.environment, line="socket"),
        **{name: getattr(judged, name) for name in TimingVerdict.__struct_fields__},
    )
    return LoopRun("sil", timing, ticks, loop.true_tip_m)


def test_one_slow_tick_among_many_is_seen(slow_run):
    timing, _ = loop_figures(slow_run)
    timeline, histogram = timing.panels
    assert "19.05 ms" in timeline.alt and "1 ticks" in timeline.alt
    assert timeline.svg.count("<use") > 0  # its mark
    assert "2.05 ms" in histogram.alt
    assert any(label == "period, 17 ms" for _, label, _ in timing.legend)


def test_misses_of_our_own_doing_are_said_and_judged(build, slow_run):
    inputs = replace(read_build(build), loops=[slow_run])
    first = verdict_sentence(slow_run)
    assert "fail" in first and "missed 1 of " in first and "1 own compute" in first
    table = results_table(inputs)
    assert row_of(table, "missed by the loop itself")[2].met is False
    cost = row_of(table, "Own cost")[2]
    assert (cost.text, cost.met) == ("0.60\u00a0ms", None), "reported, not judged"
