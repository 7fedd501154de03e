"""Report of a build: what it shows, what it judges, and what it says of missing files."""

import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest
from PIL import Image

from bench.readme_images import write_arm_gif
from dropstitch.__main__ import main
from hil.report.arm import arm_motion
from hil.report.build_inputs import LoopRun, read_build
from hil.report.build_page import origin_table, report_notices, report_page
from hil.report.loop_section import (
    error_parts,
    timing_figure,
    timing_parts,
)
from hil.report.plant_section import linear_parts
from hil.report.study_section import comparison_with_paper, motion_figures
from hil.sil.timing_verdict import TimingVerdict, judge_timing
from models.plant.plant import NOMINAL, read_plant
from models.trials.origin import TrialOrigin

RIG, MEASURED = TrialOrigin("rig", "default", 4), TrialOrigin("measured", trials=2)
UNSTATED = TrialOrigin("")


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


def row_of(table, words):
    (row,) = [r for r in table.cells if words in r[0].text]
    return row


# --- the page -----------------------------------------------------------------------------------


def test_the_page_needs_nothing_but_itself(page, html):
    tags = Page(html).tags
    assert page.stat().st_size < 2_000_000
    for tag, attributes in tags:
        assert tag not in ("script", "iframe", "object", "img")
        for name in ("src", "href", "xlink:href", "action", "srcset"):
            assert attributes.get(name, "#").startswith(("#", "data:")), (tag, attributes)
    assert not re.search(r"@import|url\((?!#)", html)
    ids = [a["id"] for _, a in tags if "id" in a]
    assert len(ids) == len(set(ids))
    targets = {v[1:] for _, a in tags for n, v in a.items() if n.endswith("href") and v[0] == "#"}
    targets |= set(re.findall(r"url\(#([^)]+)\)", html))
    assert targets and targets <= set(ids)


def test_every_drawing_is_sound_described_and_scales(html):
    drawings = re.findall(r'<div role="img" aria-label="([^"]+)">(<svg.*?</svg>)', html, re.DOTALL)
    assert len(drawings) == html.count("<figure>") > 20
    for description, svg in drawings:
        assert len(description) > 40
        root = ElementTree.fromstring(svg)
        assert "viewBox" in root.attrib and "width" not in root.attrib
        assert "font-family" not in svg
        assert "nan" not in description.lower()


def test_the_page_opens_with_the_arm_and_ends_with_the_study(html):
    sections = re.findall(r'<section id="(\w+)">', html)
    assert sections == ["arm", "errors", "timing", "plant", "fmus", "study", "made"]
    arm = html[html.index('id="arm"') : html.index('id="errors"')]
    assert "<animate " in arm and "rigid kinematics" in arm


def test_the_page_shows_the_figures_of_the_files(build, html):
    text = Page(html).text.replace("\u00a0", " ")
    for words in ("1DOF, trial 2", "2DOF, unseen 20° motion", "2DOF, phase 90°"):
        assert words in text
    study = json.loads((build / "bundle_2dof" / "study.json").read_text())
    assert f"2DOF {study['chosen_degree']})" in text
    check = json.loads((build / "check_twin_1dof.json").read_text())
    assert all(c["detail"] in text for c in check["checks"])
    commands = (build / "commands.log").read_text().splitlines()
    assert re.findall(r"<li><code>(.*?)</code>", html) == commands[1:], "each once, the last use"


def test_only_the_link_of_the_paper_is_compared_with_it(build, html):
    studies = read_build(build).studies
    (folded,) = comparison_with_paper(studies)
    assert folded.title in html and "Not reproduced" not in html
    claims = {finding.claim for study in studies.values() for finding in study.findings}
    assert claims == {row[0] for row in folded.parts[0].rows}
    of_another_link = {
        name: msgspec.structs.replace(study, findings=()) for name, study in studies.items()
    }
    assert comparison_with_paper(of_another_link) == []


@pytest.mark.slow
def test_text_from_files_is_text(copy_1dof):
    path = copy_1dof / "bundle_1dof" / "study.json"
    study = json.loads(path.read_text())
    study["findings"][0]["text"] = "<script>alert(1)</script> & more"
    path.write_text(json.dumps(study))
    (path.parent / "manifest.json").unlink()  # it has the hash of the old study
    (copy_1dof / "commands.log").write_text("dropstitch report build --out '<b>'\n")
    html = report_page(read_build(copy_1dof))
    assert "<script>" not in html and "&lt;script&gt;" in html and "&lt;b&gt;" in html
    assert "1DOF, trial 2" in html and "2DOF, trial 2" not in html, "one dof alone is enough"


def test_an_empty_directory_gives_a_page_of_instructions(tmp_path, capsys):
    assert main(["report", "build", str(tmp_path), "--json"]) == 0
    output = capsys.readouterr()
    assert "report 8/8" in output.err
    result = json.loads(output.out)
    text = Page((tmp_path / "report.html").read_text()).text
    assert result["bytes"] == (tmp_path / "report.html").stat().st_size
    assert text.count("Not in this report") == 1
    for command in ("make study", "identify", "fmu check", "dropstitch sil", "make faults"):
        assert command in text


def test_several_directories_make_one_report(build, tmp_path):
    shutil.copytree(build / "study_2dof_phase90", tmp_path / "study_2dof_phase90")
    (tmp_path / "commands.log").write_text("make study\n")
    inputs = read_build(build / "sil_1dof", tmp_path)
    assert list(inputs.studies) == ["2DOF, phase 90°"]
    assert [loop.name for loop in inputs.loops] == ["sil_1dof"]
    assert inputs.commands == ["make study"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("check_twin_1dof.json", "\xff\xfe", "write it again"),
        ("bundle_1dof/study.json", {"schema": 1}, "dropstitch train"),
        ("sil_1dof/timing.json", {"schema": 1}, "dropstitch sil"),
    ],
)
def test_a_damaged_or_older_file_gets_one_sentence(copy, capsys, name, content, words):
    path = copy / name
    if isinstance(content, dict):
        content = json.dumps(json.loads(path.read_text()) | content)
    path.write_bytes(content.encode("latin-1"))
    assert main(["report", "build", str(copy)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and words in err and path.name in err


# --- which files are read -----------------------------------------------------------------------


def test_a_second_study_of_the_same_motion_is_listed(copy):
    shutil.copytree(copy / "study_2dof_phase90", copy / "study_again")
    inputs = read_build(copy)
    assert [row.split(":")[0] for row in inputs.left_out] == ["study_again"]
    assert read_build(copy / "sil_1dof").loops[0].dof == 1, "one run alone is a build"


def test_every_phase_has_its_study_beside_the_one_of_all(build, copy):
    inputs = read_build(build)
    assert sorted(inputs.studies) == [
        "1DOF", "2DOF, all phases", "2DOF, phase 0°", "2DOF, phase 90°",
    ]  # fmt: skip
    assert inputs.robot_studies[2] is inputs.studies["2DOF, all phases"]
    for phase in (0, 90):
        shutil.rmtree(copy / f"study_2dof_phase{phase}")
    alone = read_build(copy).studies
    assert list(alone) == ["1DOF", "2DOF, all phases"]
    study = alone["2DOF, all phases"]
    paths, *_, mean_di = motion_figures({"2DOF, all phases": study})
    assert [label for _, label, _ in paths.legend][:2] == ["0 kg, phase 0°", "0 kg, phase 90°"]
    assert f"{100 * study.mean_di['0']:.2f}\u00a0%" in mean_di.panels[0].alt


# --- where the trials come from -----------------------------------------------------------------


def of_origins(inputs, of_study, of_evaluation):
    """The same build with trials of these origins."""
    study = inputs.studies["1DOF"]
    part = msgspec.structs.replace(study.training, origins=of_study)
    study = msgspec.structs.replace(study, training=part, tests={"trial_2": part})
    (title, evaluation), *_ = inputs.evaluations.items()
    evaluation = msgspec.structs.replace(evaluation, origins=of_evaluation)
    return replace(
        inputs, studies={"1DOF": study}, plant=None,
        evaluations={title: evaluation},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("of_study", "of_evaluation", "label"),
    [
        ((MEASURED,), (MEASURED,), "Measured"),
        ((RIG,), (MEASURED,), "Simulated and measured"),
        ((RIG,), (UNSTATED,), "Origin not stated"),
    ],
)
def test_the_head_says_where_the_trials_come_from(build, of_study, of_evaluation, label):
    changed = of_origins(read_build(build), of_study, of_evaluation)
    trials, loops = report_notices(changed)
    assert trials.label == label
    assert loops.label == "Emulated"  # the loop never ran on a robot, whatever the trials are
    table = origin_table(changed)
    of_loop, study = row_of(table, "Control loop, sil_1dof"), row_of(table, "Study, 1DOF")
    assert of_loop[1].text == "Simulated"
    assert of_loop[2].text == "emulated servos, the twin behind them"
    assert study[1].text == ("Measured" if of_study == (MEASURED,) else "Simulated")


def test_the_first_screen_says_where_the_trials_come_from(build, html):
    before, after = html.split('<p class="notice unknown" role="note"><strong>Origin not stated')
    assert "<h1>" in before and 'class="lead"' not in before
    assert 'class="notice simulated"' in after.split('class="lead"')[0]  # the loop is emulated
    empty = replace(read_build(build), studies={}, evaluations={}, loops=[])
    assert report_notices(empty) == [] and origin_table(empty) is None


# --- the study ----------------------------------------------------------------------------------


# --- runs of the loop ---------------------------------------------------------------------------


def test_simulated_time_makes_no_claim_about_cost(build, html):
    (loop,) = read_build(build).loops
    assert (loop.dof, loop.in_real_time) == (1, False)
    (sentence,) = timing_parts([loop])
    assert "no duration was measured" in sentence.text and "deadlines" not in html


def test_the_arm_of_a_run_moves(build, tmp_path):
    (loop,) = read_build(build).loops
    motion = arm_motion(loop)
    assert 0.0 < motion.predicted_off_m < motion.rigid_off_m
    write_arm_gif(motion, tmp_path / "link.gif", width_px=60)
    with Image.open(tmp_path / "link.gif") as picture:
        assert picture.n_frames > 10 and picture.width == 60
    assert arm_motion(replace(loop, true_tip_m=None)) is None


def test_the_plant_has_a_bode_plot_with_its_modes():
    figure, table = linear_parts(read_plant(NOMINAL))
    assert [panel.title for panel in figure.panels] == ["Gain", "Phase"]
    by_payload = {row[0]: float(row[1]) for row in reversed(table.rows)}
    assert len(by_payload) == 3
    slower = list(by_payload.values())
    assert slower == sorted(slower), "a heavier payload swings more slowly"


def test_prediction_and_plant_are_compared_tick_by_tick(build):
    (loop,) = read_build(build).loops
    predicted_m = np.column_stack([loop.ticks[f"predicted_tip_{axis}_m"] for axis in "xyz"])
    distance_m = np.linalg.norm(predicted_m - loop.true_tip_m, axis=1)
    error = loop.timing.prediction_error
    assert error.n == len(distance_m)
    assert distance_m.mean() == pytest.approx(error.mean_euclidean_distance_m, rel=1e-9)
    assert distance_m.max() == pytest.approx(error.max_m, rel=1e-9)
    summary, figure, folded = error_parts([loop])
    assert row_of(summary, "1DOF")[1].text == f"{1e3 * distance_m.mean():.1f}"
    assert len(figure.panels) == 1
    table, _ = folded.parts
    assert row_of(table, "all ticks")[1].text == str(error.n)
    counts = [int(row_of(table, w)[1].text) for w in ("rest between", "motion, as", "stop")]
    assert sum(counts) == error.n  # three seconds reach no glide


def test_one_slow_tick_among_many_is_shown_named_and_judged(build):
    """The run as if in real time, with a single tick that the loop itself made too long."""
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
    run = LoopRun("sil", timing, ticks, loop.true_tip_m)
    histogram, timeline = timing_figure(run).panels
    assert "19.05 ms" in histogram.alt and "1 ticks" in timeline.alt
    assert timeline.svg.count("<use") > 0  # its mark
    table = timing_parts([run])[0]
    assert row_of(table, "verdict")[1].met is False
    missed = row_of(table, "deadlines missed")[1].text
    assert missed.startswith("1 of ") and "1 own compute" in missed
    assert row_of(table, "missed by the loop itself")[1].text == "1"
    assert row_of(table, "own cost")[1].text == "0.60\u00a0ms"
